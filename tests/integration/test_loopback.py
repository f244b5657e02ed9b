"""The service and the simulator as processes of their own over real UDP, watched by a peer."""

from __future__ import annotations

import csv
import itertools
import json
import math
import select
import signal
import socket
import statistics
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.cli.main import main
from mavins.logs.tlog import read_tlog

pytestmark = [pytest.mark.slow, pytest.mark.jit, pytest.mark.wheel]

RATES = {
    "HEARTBEAT": 1.0,
    "LOCAL_POSITION_NED": 50.0,
    "ATTITUDE": 50.0,
    "ATTITUDE_QUATERNION": 50.0,
    "GLOBAL_POSITION_INT": 10.0,
    "ODOMETRY": 25.0,
    "HIGHRES_IMU": 10.0,
    "GPS_RAW_INT": 5.0,
    "SYS_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "VIBRATION": 1.0,
    "ESTIMATOR_STATUS": 2.0,
    "GPS_GLOBAL_ORIGIN": 1.0,
    "HOME_POSITION": 0.5,
}
ESTIMATES = set(RATES) - {"HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE"}
"""On the vehicle's clock; the others are due by the service's own."""


@dataclass
class Peer:
    """A ground station: sends a heartbeat when told, keeps all that comes back."""

    sock: socket.socket
    seen: list[tuple[float, Any]] = field(default_factory=list)

    def hello(self, port: int) -> None:
        link = dialect.MAVLink(None, 255, 190)
        message = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        self.sock.sendto(message.pack(link), ("127.0.0.1", port))

    def listen(self, until: Callable[[], bool], limit: float) -> None:
        parser = dialect.MAVLink(None)
        end = time.monotonic() + limit
        while not until() and time.monotonic() < end:
            if not select.select([self.sock], [], [], 0.1)[0]:
                continue
            data, _ = self.sock.recvfrom(65535)
            now = time.monotonic()
            messages = parser.parse_buffer(bytearray(data))
            assert messages, data
            self.seen += [(now, message) for message in messages]

    def has_heard_the_end(self) -> bool:
        stamps = [m.time_boot_ms for _, m in self.seen[-20:] if m.get_type() == "ATTITUDE"]
        return bool(stamps) and max(stamps) > 15_900

    def kinds(self) -> dict[str, list[tuple[float, Any]]]:
        kinds: dict[str, list[tuple[float, Any]]] = {}
        for now, message in self.seen:
            kinds.setdefault(message.get_type(), []).append((now, message))
        return kinds


@pytest.fixture
def peer() -> Iterator[Peer]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        yield Peer(sock)


def finite(message: Any) -> bool:
    for name in message.get_fieldnames():
        value = getattr(message, name)
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, float) and not math.isfinite(item):
                return False
    return True


def test_a_flight_over_udp(
    serve: Callable[..., Any],
    fly_process: Callable[..., subprocess.Popen[bytes]],
    peer: Peer,
    tmp_path: Path,
) -> None:
    out, log = tmp_path / "out", tmp_path / "flight.tlog"
    service = serve("--out", str(out), "--record", str(log), "--status", "json")
    peer.hello(service.port)
    simulator = fly_process(service.port, 15.0)
    peer.listen(lambda: simulator.poll() is not None, 60.0)
    assert simulator.wait(10.0) == 0
    # what a busy service still has to tell of the last second
    peer.listen(peer.has_heard_the_end, 20.0)
    service.stop(signal.SIGINT)

    streams_arrive_at_their_rates(peer)
    status_lines_tell_of_the_flight(service.lines[1:])
    files_are_whole(out, log)
    # the recording gives the same estimates again, to the last byte
    assert main(["-q", "replay", str(log), "--out", str(tmp_path / "again")]) == 0
    for name in ("estimates.csv", "innovations.csv"):
        live = (out / "eskf" / name).read_bytes()
        assert live.count(b"\n") > 50
        assert live == (tmp_path / "again/eskf" / name).read_bytes(), name
    again = json.loads((tmp_path / "again/summary.json").read_text())
    summary = json.loads((out / "summary.json").read_text())
    for key in ("imu", "imu_samples", "health", "resets", "rows"):
        assert summary[key] == again[key], key
    for name, aiding in summary["aiding"].items():
        for key in ("accepted", "rejected"):
            assert aiding[key] == again["aiding"][name][key], name
        assert aiding["nis_per_row"] == pytest.approx(again["aiding"][name]["nis_per_row"])
    assert max(summary["truth"]["rms"]["pos_m"]) < 1.0
    assert summary["truth"]["rms"]["pos_m"] == pytest.approx(
        again["truth"]["rms"]["pos_m"], abs=0.1
    )


def streams_arrive_at_their_rates(peer: Peer) -> None:
    assert {m.get_srcSystem() for _, m in peer.seen} == {100}
    assert {m.get_srcComponent() for _, m in peer.seen} == {1}
    numbers = [m.get_seq() for _, m in peer.seen]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))
    assert all(finite(m) for _, m in peer.seen)
    kinds = peer.kinds()
    assert set(kinds) == {*RATES, "STATUSTEXT"}
    running = next(t for t, m in kinds["STATUSTEXT"] if "running" in m.text)
    last = kinds["LOCAL_POSITION_NED"][-1][0]
    assert last - running > 8.0
    for kind in ESTIMATES:
        assert kinds[kind][0][0] >= running - 0.05, f"{kind} before the filter runs"
    # whoever is held up on a busy machine catches up on the vehicle's clock; a period more or less at the ends
    span = (kinds["ATTITUDE"][-1][1].time_boot_ms - kinds["ATTITUDE"][0][1].time_boot_ms) * 1e-3
    for kind in ESTIMATES:
        assert len(kinds[kind]) == pytest.approx(RATES[kind] * span, abs=2.0), kind
    # by its own clock a service that was held up goes on, and makes up for nothing
    for kind in RATES.keys() - ESTIMATES:
        gaps = [b - a for (a, _), (b, _) in itertools.pairwise(kinds[kind])]
        assert statistics.median(gaps) == pytest.approx(1.0 / RATES[kind], abs=0.15), kind
    # the boot clock starts at 1 s, and each stream's stamps lie on its grid
    for kind in ("LOCAL_POSITION_NED", "ATTITUDE", "ATTITUDE_QUATERNION"):
        stamps = [m.time_boot_ms for _, m in kinds[kind]]
        assert 1000 < stamps[0] < 10_000
        assert 14_900 < stamps[-1] <= 16_000
        assert all(b - a == 20 for a, b in itertools.pairwise(stamps)), kind


def status_lines_tell_of_the_flight(lines: list[str]) -> None:
    snapshots = [s for line in lines if (s := json.loads(line))["vehicles"]]
    assert len(snapshots) > 10
    vehicle = snapshots[-1]["vehicles"][0]
    assert vehicle["sysid"] == 1
    assert vehicle["health"] == "running"
    # a busy machine shows it in the rate of each moment; of the streams this is the only one above 50 Hz
    rates = [line["vehicles"][0]["rates"].get("HIGHRES_IMU", 0) for line in snapshots[3:]]
    assert statistics.median(rates) == pytest.approx(250, abs=125)
    assert vehicle["aidings"]["gnss_position"]["fused"] > 30
    assert math.hypot(*vehicle["error"]["pos"]) < 2.0


def files_are_whole(out: Path, log: Path) -> None:
    frames = read_tlog(log)
    assert not frames.damage
    assert {1, 100, 255} <= set(frames.sysid.tolist())
    for name in ("estimates.csv", "innovations.csv"):
        text = (out / "eskf" / name).read_text()
        assert text.endswith("\n")
        rows = list(csv.reader(text.splitlines()))
        assert {len(row) for row in rows} == {len(rows[0])}
    assert (out / "eskf/config.yaml").read_text().endswith("\n")
    assert not list(out.rglob("*.part"))


def test_a_ground_station_that_never_sent_and_one_that_falls_silent(
    serve: Callable[..., Any],
    fly_process: Callable[..., subprocess.Popen[bytes]],
    peer: Peer,
    tmp_path: Path,
) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("mavlink:\n  peer_timeout: 2.0\n")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        named = Peer(sock)
        address = f"127.0.0.1:{sock.getsockname()[1]}"
        service = serve("--gcs", address, "--config", str(settings), "--status", "off")
        peer.hello(service.port)
        said_hello = time.monotonic()
        simulator = fly_process(service.port, 7.0)
        listener = threading.Thread(
            target=named.listen, args=(lambda: simulator.poll() is not None, 40.0)
        )
        listener.start()
        peer.listen(lambda: simulator.poll() is not None, 40.0)
        listener.join()
        assert service.stop(signal.SIGTERM) == ""
    assert len(named.kinds()["LOCAL_POSITION_NED"]) > 100
    assert len(named.kinds()["HEARTBEAT"]) >= 6
    # the one that sent a single heartbeat heard from us for two seconds of seven, and a busy machine's time
    assert all(t - said_hello < 5.0 for t, _ in peer.seen)
    assert service.lines[1:] == []


def test_a_signal_right_after_listening_ends_it_cleanly(serve: Callable[..., Any]) -> None:
    serve().stop(signal.SIGINT)
    serve("-q").stop(signal.SIGTERM)
