"""The service without sockets: links in memory, files behind it, the status in front."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.config import Config
from mavins.errors import OutputError
from mavins.mavlink.codec import frame, heartbeat, highres_imu
from mavins.service import Service, check_outputs, is_local
from mavins.types import ImuSample

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

NOW_US = 1_790_000_000_000_000
HERE = (0, "127.0.0.1", 5000)


class Wire:
    """A link that keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, Any]] = []
        self.closed = False

    def send(self, data: bytes, address: Any) -> None:
        self.sent.append((data, address))

    def close(self) -> None:
        self.closed = True


def imu(sysid: int, t_us: int) -> bytes:
    sample = ImuSample(t_us, np.array([0.0, 0.0, -9.8]), np.zeros(3))
    return frame(highres_imu(sample), sysid, 1, 0)


@pytest.mark.parametrize(
    ("address", "local"),
    [
        ((0, "127.0.0.1", 1), True),
        ((1, "127.8.0.1", 1), True),
        ((0, "192.168.1.20", 1), False),
        ((0, "128.0.0.1", 1), False),
        ("elsewhere", False),
    ],
)
def test_who_is_on_this_host(address: Any, local: bool) -> None:
    assert is_local(address) is local


def test_each_link_carries_its_own_peers(tmp_path: Path) -> None:
    first, second = Wire(), Wire()
    service = Service(Config(), [first, second], [(0, "127.0.0.1", 9)])  # type: ignore[list-item]
    service.session.receive(imu(1, 1_000_000), HERE, NOW_US)
    service.session.receive(frame(heartbeat(6, 8), 255, 190, 0), (1, "127.0.0.1", 7), NOW_US)
    service.session.tick(NOW_US + 1)
    assert {to for _, to in first.sent} == {("127.0.0.1", 9), ("127.0.0.1", 5000)}
    assert {to for _, to in second.sent} == {("127.0.0.1", 7)}
    service.close()
    assert first.closed
    assert second.closed


@pytest.mark.jit
def test_files_of_two_vehicles(tmp_path: Path) -> None:
    out, log = tmp_path / "out", tmp_path / "flight.tlog"
    service = Service(Config(), [Wire()], (), out, log)  # type: ignore[list-item]
    for k in range(5):
        for sysid in (4, 9):
            address = (0, "127.0.0.1", 5000 + sysid)
            service.session.receive(imu(sysid, 1_000_000 + 4000 * k), address, NOW_US + 4000 * k)
    service._write_rows()
    service._flush()
    assert log.stat().st_size > 0
    service.close()
    for base, sysid in ((out, 4), (out / "vehicle_9", 9)):
        assert (base / "eskf/estimates.csv").read_text().startswith("t_us,")
        assert (base / "eskf/config.yaml").exists()
        summary = json.loads((base / "summary.json").read_text())
        assert summary["sysid"] == sysid
        assert summary["imu_samples"] == 5
        assert summary["service"]["packets_in"] == 10


def test_the_status(tmp_path: Path) -> None:
    service = Service(Config(), [Wire()])  # type: ignore[list-item]
    before = service.snapshot(0.0)
    assert (before.peers, before.vehicles) == (0, ())
    service.session.receive(b"noise" + imu(4, 1_000_000), HERE, service._now_us())
    snapshot = service.snapshot(1.0)
    (vehicle,) = snapshot.vehicles
    assert (vehicle.sysid, vehicle.health, vehicle.estimate) == (4, "waiting", None)
    assert (snapshot.peers, snapshot.packets_in) == (1, 1)
    assert snapshot.dropped == {"skipped bytes": 5}
    assert vehicle.rates["HIGHRES_IMU"] > 0.0
    service.close()


def test_outputs_are_checked_before_there_are_any(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    check_outputs(Config(), None, None)
    check_outputs(Config(), tmp_path / "out", tmp_path / "logs" / "x.tlog")
    assert (tmp_path / "out" / "eskf").is_dir()
    with pytest.raises(OutputError):
        check_outputs(Config(), tmp_path / "file" / "out", None)
    with pytest.raises(OutputError):
        check_outputs(Config(), None, tmp_path / "file" / "x.tlog")


def test_what_fails_at_the_end_does_not_keep_the_rest_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = Wire()
    service = Service(Config(), [wire], (), tmp_path / "out", tmp_path / "x.tlog")  # type: ignore[list-item]
    service.session.receive(imu(4, 1_000_000), HERE, NOW_US)

    def full(path: Path, content: Any) -> None:
        raise OutputError("cannot write: No space left on device")

    monkeypatch.setattr("mavins.service.write_json", full)
    with pytest.raises(OutputError):
        service.close()
    assert wire.closed
    assert (tmp_path / "x.tlog").stat().st_size > 8
