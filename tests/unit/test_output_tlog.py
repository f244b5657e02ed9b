"""The messages about a log's vehicle: those that a live session would have sent, and no estimate moves for them."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil

from mavins.config import Config, load
from mavins.estimator.estimator import Estimator
from mavins.logs.tlog import TlogWriter, read_tlog
from mavins.mavlink.codec import (
    Payload,
    attitude,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
)
from mavins.mavlink.session import Session, Surroundings
from mavins.output_tlog import OutputLog
from mavins.tlog_source import TlogSource
from mavins.types import GnssFix, ImuSample

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

UNIX_US = 1_790_000_000_000_000
LAT, LON, ALT = math.radians(47.4), math.radians(8.5), 500.0
STILL = (0.0, 0.0, 0.0)
SECONDS = 12


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vehicle that stands, 50 Hz IMU, 5 Hz fixes, with every message's stamp its time of arrival less 3 ms."""
    path = tmp_path_factory.mktemp("log") / "flight.tlog"
    with TlogWriter(path) as writer:
        for t_us, payload in still():
            writer.write(UNIX_US + t_us + 3_000, frame(payload, 1, 1, 0))
    return path


def still() -> list[tuple[int, Payload]]:
    items: list[tuple[int, Payload]] = [(1_000_000, heartbeat(2, 0))]
    for k in range(SECONDS * 50):
        t_us = 1_000_000 + 20_000 * k
        sample = ImuSample(t_us, np.array([0.0, 0.0, -9.808]), np.zeros(3))
        items.append((t_us, highres_imu(sample)))
        if k % 50 == 1:
            items.append((t_us, heartbeat(2, 0)))
        if k % 5 == 0:
            items.append((t_us, attitude(t_us, 0.0, 0.0, 0.0, STILL)))
        if k % 10 == 0:
            fix = GnssFix(t_us, LAT, LON, ALT, STILL, 3, 12, 0.5, 0.8, 0.1)
            items.append((t_us, gps_raw_int(fix)))
            items.append((t_us, global_position_int(t_us, LAT, LON, ALT, 0.0, STILL, None)))
    return items


def said(log: Path, out: Path, config: Config) -> Path:
    source = TlogSource(log, config)
    path = out / "output.tlog"
    estimator = Estimator(config, config.filter)
    relay = OutputLog(path, estimator, config, *source.speaker(), source.received_us)
    source.feed(relay, lambda _: None)
    relay.close()
    return path


def bodies(path: Path) -> dict[int, list[tuple[int, bytes]]]:
    """Message id -> what came, in order: the stamp of its estimate is in it."""
    frames = read_tlog(path)
    found: dict[int, list[tuple[int, bytes]]] = {}
    for i in range(len(frames)):
        body = bytes(frames.packet(i)[10:-2])
        found.setdefault(int(frames.msgid[i]), []).append((int(frames.t_us[i]), body))
    return found


def live(log: Path, out: Path, config: Config) -> Path:
    """What a session says to the same packets, recorded."""
    path = out / "live.tlog"

    class Ours:
        def __init__(self) -> None:
            self.log = TlogWriter(path)

        def write(self, t_us: int, packet: bytes) -> None:
            if packet[5] != 1:
                self.log.write(t_us, packet)

    recorder = Ours()
    session = Session(
        config,
        lambda sysid: Estimator(config, config.filter),
        Surroundings(recorder=recorder),
    )
    frames = read_tlog(log)
    tick_us = 0
    for i in range(len(frames)):
        now_us = int(frames.t_us[i])
        session.receive(bytes(frames.packet(i)), "vehicle", now_us)
        if now_us >= tick_us:
            tick_us = now_us + 50_000
            session.tick(now_us)
    recorder.log.close()
    return path


ESTIMATE = {
    30: "ATTITUDE",
    31: "ATTITUDE_QUATERNION",
    32: "LOCAL_POSITION_NED",
    33: "GLOBAL_POSITION_INT",
    105: "HIGHRES_IMU",
    331: "ODOMETRY",
}


def test_a_session_says_the_same(log: Path, tmp_path: Path) -> None:
    config = load(None, {"asking.enabled": False})
    ours, theirs = bodies(said(log, tmp_path, config)), bodies(live(log, tmp_path, config))
    assert set(ours) == set(theirs)
    for msgid, name in ESTIMATE.items():
        assert len(ours[msgid]) > 10, name
        mine, live_ones = dict(ours[msgid]), dict(theirs[msgid])
        # where the estimate begins a session may be a sample ahead
        assert len(set(mine) ^ set(live_ones)) <= 2, name
        assert all(mine[stamp] == live_ones[stamp] for stamp in set(mine) & set(live_ones)), name


def test_rates_and_ids_are_those_of_the_configuration(log: Path, tmp_path: Path) -> None:
    config = load(None, {"streams.attitude": 10.0, "streams.odometry": 0.0, "mavlink.sysid": 42})
    reader: Any = mavutil.mavlink_connection(str(said(log, tmp_path, config)))
    counts: Counter[str] = Counter()
    sequence, stamps = [], []
    while (message := reader.recv_match()) is not None:
        counts[message.get_type()] += 1
        assert (message.get_srcSystem(), message.get_srcComponent()) == (42, 1)
        sequence.append(message.get_seq())
        stamps.append(message._timestamp)
    assert counts["ODOMETRY"] == counts["BAD_DATA"] == 0
    assert counts["HEARTBEAT"] in (SECONDS - 1, SECONDS, SECONDS + 1)
    seconds = counts["LOCAL_POSITION_NED"] / 50.0
    assert 5.0 < seconds < SECONDS
    assert counts["ATTITUDE"] == pytest.approx(10.0 * seconds, abs=2)
    assert counts["GPS_RAW_INT"] == pytest.approx(5.0 * seconds, abs=2)
    assert counts["STATUSTEXT"] >= 1
    assert sequence == [k % 256 for k in range(len(sequence))]
    assert stamps == sorted(stamps)
    # the recorder's clock, not that of the stamps in the messages
    assert stamps[-1] == pytest.approx((UNIX_US + 1_000_000 + 3_000) * 1e-6 + SECONDS, abs=0.1)


def test_the_estimate_is_the_same_with_it(log: Path, tmp_path: Path) -> None:
    config = Config()
    source, alone = TlogSource(log, config), Estimator(config, config.filter)
    source.feed(alone, lambda _: None)
    source, watched = TlogSource(log, config), Estimator(config, config.filter)
    relay = OutputLog(
        tmp_path / "output.tlog", watched, config, *source.speaker(), source.received_us
    )
    source.feed(relay, lambda _: None)
    relay.close()
    a, b = alone.solution(), watched.solution()
    assert a is not None
    assert b is not None
    assert a.t_us == b.t_us
    for name in ("p_n", "v_n", "q_nb", "b_g", "b_a", "P"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
