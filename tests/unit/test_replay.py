"""A log through the estimator: which vehicle, which origins, and what the summary says."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.config import Config, load
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator, Outputs
from mavins.logs.tlog import TlogWriter, read_tlog
from mavins.mavlink.codec import (
    Frames,
    Payload,
    attitude,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    hil_state_quaternion,
)
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.mavlink.parameters import set_again
from mavins.mavlink.requests import decode_packet
from mavins.mavlink.settings import SessionSettings
from mavins.parameters import ConfigStore, file_keeper
from mavins.replay import ReplayOptions, replay
from mavins.results import ResultWriter
from mavins.runs import grid_us
from mavins.sources import tape_of
from mavins.tlog_source import tune
from mavins.tlog_survey import Survey
from mavins.types import GnssFix, ImuSample, TruthSample

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

UNIX_US = 1_790_000_000_000_000
LAT, LON, ALT = math.radians(47.4), math.radians(8.5), 500.0
STILL = (0.0, 0.0, 0.0)


def imu(t_us: int) -> Payload:
    return highres_imu(ImuSample(t_us, np.array([0.0, 0.0, -9.808]), np.zeros(3)))


def still(seconds: float, fix_type: int = 3) -> list[tuple[int, Payload]]:
    """A vehicle that stands: 50 Hz IMU, 5 Hz fixes, 10 Hz heading and truth."""
    items: list[tuple[int, Payload]] = [(1_000_000, heartbeat(2, 0))]
    for k in range(round(seconds * 50)):
        t_us = 1_000_000 + 20_000 * k
        items.append((t_us, imu(t_us)))
        if k % 50 == 1:
            items.append((t_us, heartbeat(2, 0)))
        if k % 5 == 0:
            truth = TruthSample(t_us, LAT, LON, ALT, STILL, (1.0, 0.0, 0.0, 0.0))
            items.append((t_us, attitude(t_us, 0.0, 0.0, 0.0, STILL)))
            items.append((t_us, hil_state_quaternion(truth, (0.0, 0.0, -9.8), STILL)))
        if k % 10 == 0:
            fix = GnssFix(t_us, LAT, LON, ALT, STILL, fix_type, 12, 0.5, 0.8, 0.1)
            items.append((t_us, gps_raw_int(fix)))
            items.append((t_us, global_position_int(t_us, LAT, LON, ALT, 0.0, STILL, None)))
    return items


def log_of(path: Path, items: list[tuple[int, Payload | bytes]], sysid: int = 1) -> Path:
    with TlogWriter(path) as log:
        for t_us, item in items:
            packet = item if isinstance(item, bytes) else frame(item, sysid, 1, 0)
            log.write(UNIX_US + t_us, packet)
    return path


def origin(target: int, lat: float, sysid: int = 255) -> bytes:
    message = dialect.MAVLink_set_gps_global_origin_message(
        target, round(math.degrees(lat) * 1e7), round(math.degrees(LON) * 1e7), round(ALT * 1e3)
    )
    return bytes(message.pack(dialect.MAVLink(None, sysid, 190)))


def test_grid() -> None:
    assert grid_us(50.0) == 20_000
    assert grid_us(0.0) == 0
    assert grid_us(3.0) == 333_333
    assert grid_us(1e9) == 1


def surveyed(
    frames: Frames,
    wanted: int | None = None,
    settings: SessionSettings | None = None,
    size: int = 1000,
) -> Survey:
    """A survey of packets in blocks of `size`."""
    survey = Survey(settings or SessionSettings(), wanted)
    for start in range(0, len(frames), size):
        survey.see(frames.select(np.arange(start, min(start + size, len(frames)))))
    return survey


def test_the_vehicle_is_the_first_that_sends_an_imu(tmp_path: Path) -> None:
    packets: list[tuple[int, Payload | bytes]] = [
        (0, frame(heartbeat(2, 0), 3, 1, 0)),
        (1, frame(imu(1), 9, 1, 0)),
        (2, frame(imu(2), 4, 1, 0)),
    ]
    frames = read_tlog(log_of(tmp_path / "a.tlog", packets))
    assert surveyed(frames).check() == 9
    assert surveyed(frames, 4).check() == 4
    with pytest.raises(LogFormatError, match=r"vehicle 3 sends no IMU .* 4, 9"):
        surveyed(frames, 3).check()
    silent = read_tlog(log_of(tmp_path / "b.tlog", packets[:1]))
    with pytest.raises(LogFormatError, match="no IMU messages"):
        surveyed(silent).check()


def test_our_sysid_is_found_again(tmp_path: Path) -> None:
    packets: list[tuple[int, Payload | bytes]] = [
        (0, frame(heartbeat(6, 8), 100, 190, 0)),
        (1, frame(imu(1), 1, 1, 0)),
        (2, frame(imu(2), 101, 1, 0)),  # ours about vehicle 1, as 100 is taken
        (3, frame(imu(3), 2, 1, 0)),
    ]
    frames = read_tlog(log_of(tmp_path / "a.tlog", packets))
    for size in (1, 2, 4):  # however the log is parted
        assert surveyed(frames, 1, size=size).identity == (101, 1)
        assert surveyed(frames, 2, size=size).identity == (102, 1)
        assert surveyed(frames, 1, SessionSettings(sysid=50), size).identity == (50, 1)
        assert surveyed(frames, 77, size=size).identity is None


@pytest.mark.jit
def test_a_replay(tmp_path: Path) -> None:
    log = log_of(tmp_path / "still.tlog", still(6.0))
    seen: list[float] = []
    out = tmp_path / "out"
    summary = replay(log, out, Config(), ReplayOptions(), seen.append)
    assert seen[-1] == 1.0
    assert summary == {**summary, "sysid": 1, "filter": "eskf", "log": str(log)}
    assert json.loads((out / "summary.json").read_text()) == summary
    assert summary["imu"] == {"message": "HIGHRES_IMU", "id": 0}
    assert summary["imu_samples"] == summary["messages"]["HIGHRES_IMU"] == 300
    assert summary["truth"]["source"] == "HIL_STATE_QUATERNION"
    assert max(summary["truth"]["rms"]["pos_m"]) < 0.1
    assert max(summary["truth"]["max"]["att_deg"]) < 0.5
    assert summary["damage"] == {"bad_crc": 0, "unknown": 0, "skipped_bytes": 0, "truncated": 0}
    lines = (out / "eskf/estimates.csv").read_text().splitlines()
    assert len(lines) == summary["rows"] + 1
    assert 100 < summary["rows"] < 300
    assert load(out / "eskf/config.yaml") == Config()


@pytest.mark.jit
def test_a_smoothed_replay(tmp_path: Path) -> None:
    """The same columns and instants; a request for another origin in the middle breaks nothing."""
    items: list[Any] = still(8.0)
    items.insert(len(items) * 3 // 4, (7_000_000, origin(0, LAT + 1e-6)))
    log = log_of(tmp_path / "still.tlog", items)
    summary = replay(log, tmp_path / "out", Config(), ReplayOptions(start=4.5, smooth=True))
    tables = []
    for name in ("estimates", "smoothed"):
        lines = (tmp_path / f"out/eskf/{name}.csv").read_text().splitlines()
        tables.append((lines[0], np.array([row.split(",") for row in lines[1:]], dtype=float)))
    (header, rows), (smoothed_header, smoothed) = tables
    assert smoothed_header == header
    np.testing.assert_array_equal(smoothed[:, 0], rows[:, 0])
    assert len(rows) == summary["rows"] > 100
    sigmas = slice(16, 25)
    assert np.all(smoothed[:, sigmas] <= rows[:, sigmas] + 1e-6)
    assert smoothed[0, 16] < 0.8 * rows[0, 16]
    # each origin's rows are smoothed on their own, and end where the filter does
    for k in (np.flatnonzero(np.diff(rows[:, 4]) < -3.0)[0], -1):
        np.testing.assert_allclose(smoothed[k], rows[k], rtol=1e-6, atol=2e-6)
    assert set(summary["smoothed"]) == {"instants", "rms", "max"}
    assert max(summary["smoothed"]["rms"]["pos_m"]) < 0.1


@pytest.mark.jit
def test_a_log_without_an_estimate_says_why(tmp_path: Path) -> None:
    log = log_of(tmp_path / "nofix.tlog", still(4.0, fix_type=1))
    summary = replay(log, tmp_path / "out", Config(), ReplayOptions())
    assert summary["rows"] == 0
    assert summary["health"] == "waiting"
    assert "no 3D fix" in summary["reason"]
    assert "truth" not in summary
    summary = replay(log, tmp_path / "out", Config(), ReplayOptions(smooth=True))
    assert len((tmp_path / "out/eskf/smoothed.csv").read_text().splitlines()) == 1


@pytest.mark.jit
@pytest.mark.parametrize(
    ("target", "sender", "taken"),
    [(0, 255, True), (100, 255, True), (1, 255, False), (55, 255, False), (0, 1, True)],
)
def test_origins_that_were_asked_of_us(
    target: int, sender: int, taken: bool, tmp_path: Path
) -> None:
    items: list[Any] = still(5.0)
    items.insert(len(items) // 2, (3_500_000, origin(target, LAT + 1e-5, sender)))
    log = log_of(tmp_path / "asked.tlog", items)
    replay(log, tmp_path / "out", Config(), ReplayOptions(rate=5.0))
    last = (tmp_path / "out/eskf/estimates.csv").read_text().splitlines()[-1]
    p_n = float(last.split(",")[4])
    assert p_n == pytest.approx(-63.7 if taken else 0.0, abs=0.5)


def param_set(name: str, value: float, target: int, component: int = 1) -> bytes:
    message = dialect.MAVLink_param_set_message(target, component, name.encode(), value, 9)
    return bytes(message.pack(dialect.MAVLink(None, 255, 190)))


SETS = [
    (7.0, "IMU_GYRO_NOISE", 0.05),
    (8.0, "FILTER", 3.0),
    (9.0, "GNSS_DELAY", 0.1),
    (9.5, "GNSS_GATE", -1.0),
    (10.0, "SRC_HEADING", 2.0),
    (11.0, "EST_BUFFER", 3.0),
]
"""Seconds, names and values: one is out of range, one waits for a restart."""


def with_sets(target: int) -> list[tuple[int, Payload | bytes]]:
    extra = [(round(1e6 * (1 + t)), param_set(n, v, target)) for t, n, v in SETS]
    return sorted([*still(14.0), *extra], key=lambda item: item[0])


def fed_one_by_one(log: Path, out: Path) -> Estimator:
    """What a live session does: packet by packet, a parameter set at its place."""
    frames, config = read_tlog(log), Config()
    with ResultWriter(out, config.states.layout()) as writer:
        outputs = Outputs(grid_us(50.0), writer.write_rows, writer.write_decision)
        estimator = Estimator(config, config.filter, outputs)
        intake = Intake(estimator, config.sources)
        store = ConfigStore(config, partial(tune, intake), file_keeper(None))
        for i in range(len(frames)):
            one = frames.select(np.array([i]))
            if int(frames.msgid[i]) in RELEVANT:
                intake.take(one)
                continue
            message = decode_packet(frames, i)
            if message is not None and message.get_type() == "PARAM_SET":
                set_again(message, store)
        estimator.finish()
    return estimator


def test_parameters_are_set_again_where_they_were_set(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.tlog", with_sets(100))
    summary = replay(log, tmp_path / "replayed", Config(), ReplayOptions())
    estimator = fed_one_by_one(log, tmp_path / "live")
    for name in ("estimates.csv", "innovations.csv"):
        live = (tmp_path / "live" / name).read_bytes()
        assert live == (tmp_path / "replayed" / "eskf" / name).read_bytes()
    assert summary["resets"] == 0
    assert type(estimator.filter).__name__ == "Ieskf"
    assert estimator.settings.gnss.delay == 0.1
    assert estimator.settings.estimator.buffer == Config().estimator.buffer
    # heading off: nothing but what came before is fused
    plain = replay(
        log_of(tmp_path / "b.tlog", still(14.0)), tmp_path / "plain", Config(), ReplayOptions()
    )
    fused = [s["aiding"]["heading"]["accepted"] for s in (summary, plain)]
    assert fused[0] < fused[1]


def test_a_comparison_changes_settings_but_not_the_filter(tmp_path: Path) -> None:
    tape, _ = tape_of(log_of(tmp_path / "a.tlog", with_sets(100)), Config())
    assert tape.settings == Config()
    told = [what for name, what in tape.feeds if name == "reconfigure"]
    assert [s.imu.gyro_noise for s in told] == [0.05] * 4
    estimator = Estimator(tape.settings, "srcdkf")
    tape.play(estimator)
    assert type(estimator.filter).__name__ == "Srcdkf"
    assert estimator.settings.imu.gyro_noise == 0.05


@pytest.mark.parametrize(("target", "component"), [(1, 1), (100, 20)])
def test_parameters_of_others_are_left_alone(tmp_path: Path, target: int, component: int) -> None:
    extra = [(8_000_000, param_set("FILTER", 2.0, target, component))]
    items = sorted([*still(10.0), *extra], key=lambda item: item[0])
    for name, log in (("set", items), ("plain", still(10.0))):
        replay(log_of(tmp_path / f"{name}.tlog", log), tmp_path / name, Config(), ReplayOptions())
    a, b = ((tmp_path / n / "eskf" / "estimates.csv").read_bytes() for n in ("set", "plain"))
    assert a == b
