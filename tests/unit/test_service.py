"""The service without sockets: links in memory, files behind it, the status in front."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.config import Config
from mavins.errors import OutputError
from mavins.logs.recording import Recording
from mavins.logs.tlog import read_tlog
from mavins.mavlink.codec import fields_of, frame, heartbeat, highres_imu, payload, scan
from mavins.mavlink.signing import Clock, Key, Signer, SigningSettings, Verifier, is_signed
from mavins.service import Service, check_outputs
from mavins.signing_store import Signing
from mavins.types import ImuSample

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

NOW_US = 1_790_000_000_000_000
HERE = (0, "127.0.0.1", 5000)


class Wire:
    """A link that keeps what is sent and hands over what it was given."""

    def __init__(self, is_stream: bool = False, trusted: bool = False, peers: Any = ()) -> None:
        self.is_stream = is_stream
        self.trusted = trusted
        self.peers = peers
        self.dropped: Counter[str] = Counter()
        self.sent: list[tuple[bytes, Any]] = []
        self.waiting: list[tuple[bytes, Any]] = []
        self.ticks = 0
        self.closed = False

    def recv(self, timeout: float) -> list[tuple[bytes, Any]]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def tick(self) -> None:
        self.ticks += 1

    def prefer(self, peers: list[Any]) -> None:
        pass

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
        ((0, "::1", 1), True),
        ((0, "::ffff:127.0.0.1", 1), True),
        ((0, "::ffff:192.168.1.20", 1), False),
        ((0, "::11", 1), False),
        ((0, "fe80::1%eth0", 1), False),
        ((0, "/dev/ttyAMA0", 0), False),
        ((0, "192.168.1.20", 1), False),
        ((0, "128.0.0.1", 1), False),
        ("elsewhere", False),
    ],
)
def test_who_is_on_this_host(address: Any, local: bool) -> None:
    service = Service(Config(), [Wire(), Wire()])  # type: ignore[list-item]
    assert service._may_change(address) is local
    service.close()


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
    service = Service(Config(), [Wire()], (), out, Recording(log))  # type: ignore[list-item]
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
    service = Service(Config(), [wire], (), tmp_path / "out", Recording(tmp_path / "x.tlog"))  # type: ignore[list-item]
    service.session.receive(imu(4, 1_000_000), HERE, NOW_US)

    def full(path: Path, content: Any) -> None:
        raise OutputError("cannot write: No space left on device")

    monkeypatch.setattr("mavins.service.write_json", full)
    with pytest.raises(OutputError):
        service.close()
    assert wire.closed
    assert (tmp_path / "x.tlog").stat().st_size > 8


def test_packets_of_a_stream_are_put_together_for_each_end() -> None:
    line, wire = Wire(is_stream=True), Wire()
    service = Service(Config(), [line, wire])  # type: ignore[list-item]
    here, there = ("127.0.0.1", 1), ("127.0.0.1", 2)
    one, two = imu(1, 1_000_000), imu(2, 1_000_000)
    line.waiting = [(one[:20], here), (two[:40], there), (one[20:] + one[:5], here)]
    service._drain(0)
    assert service.session.packets_in == 1
    line.waiting = [(two[40:], there), (one[5:], here)]
    service._drain(0)
    assert service.session.packets_in == 3
    assert sorted(service.session.vehicles) == [1, 2]
    # datagrams are not: the rest of a broken one is not looked for
    wire.waiting = [(one[:20], here), (one[20:], here)]
    service._drain(1)
    assert service.session.packets_in == 3
    service.close()


def test_a_stream_that_ends_leaves_nothing_behind() -> None:
    line = Wire(is_stream=True, peers=(("named", 0),))
    service = Service(Config(), [line])  # type: ignore[list-item]
    old, new, packet = ("127.0.0.1", 1), ("127.0.0.1", 2), imu(1, 1_000_000)
    line.waiting = [(packet + packet[:30], old), (b"", old)]
    service._drain(0)
    assert list(service.session.peers) == [(0, "named", 0)]
    assert service.session.dropped["truncated"] == 1
    # it comes back from another port, and need not wait until it counts as silent
    line.waiting = [(imu(1, 1_004_000), new)]
    service._drain(0)
    assert service.session.vehicles[1].holder.address == (0, *new)
    assert service.session.packets_in == 2
    assert not any("another address" in reason for reason in service.session.dropped)
    line.waiting = [(b"", ("named", 0))]
    service._drain(0)
    assert (0, "named", 0) in service.session.peers
    service.close()


def test_a_tick_tends_the_links_and_what_waits_in_a_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Wire(is_stream=True)
    service = Service(Config(), [line])  # type: ignore[list-item]
    now = [NOW_US]
    monkeypatch.setattr(service, "_now_us", lambda: now[0])
    lost, beat = imu(1, 1_000_000)[:20], frame(heartbeat(2, 3), 1, 1, 0)
    line.waiting = [(lost + beat, ("127.0.0.1", 1))]
    service._drain(0)
    assert service.session.packets_in == 0
    now[0] += 200_000
    service._tick()
    assert service.session.packets_in == 1
    assert line.ticks == 1
    service.close()


def test_what_links_could_not_send_is_counted_with_the_rest() -> None:
    line, wire = Wire(is_stream=True), Wire()
    line.dropped.update({"link congested": 3, "not sent": 0})
    wire.dropped["link congested"] = 4
    service = Service(Config(), [line, wire])  # type: ignore[list-item]
    assert service.snapshot(1.0).dropped == {"link congested": 7}
    service.close()


@pytest.mark.parametrize("trusted", [False, True])
def test_only_a_trusted_line_may_change_the_state(trusted: bool) -> None:
    line, wire = Wire(is_stream=True, trusted=trusted), Wire()
    service = Service(Config(), [line, wire])  # type: ignore[list-item]
    assert service._may_change((0, "/dev/ttyAMA0", 0)) is trusted
    assert service._may_change((1, "192.168.1.20", 14550)) is False
    assert service._may_change((1, "127.0.0.1", 14550)) is True
    service.close()


# ---- signing and limits --------------------------------------------------------------------------

SECRET = bytes(range(1, 33))
FAR = (0, "10.0.0.9", 14550)


def open_signing(tmp_path: Path) -> Signing:
    path = tmp_path / "signing.key"
    path.write_bytes(SECRET)
    path.chmod(0o600)
    return Signing(path)


def signer(link_id: int = 7) -> Signer:
    return Signer(Key(SECRET), link_id, Clock(lambda: time.time_ns() // 1000))


def origin(target: int) -> bytes:
    return frame(
        payload(
            fields_of("SET_GPS_GLOBAL_ORIGIN"),
            latitude=470000000,
            longitude=80000000,
            target_system=target,
        ),
        255,
        190,
        0,
    )


def test_with_a_key_only_signed_packets_come_in_and_go_out(tmp_path: Path) -> None:
    wire, theirs = Wire(), signer()
    config = Config(signing=SigningSettings(unsigned="none"))
    recording = Recording(tmp_path / "x.tlog")
    service = Service(config, [wire], (), None, recording, None, open_signing(tmp_path))  # type: ignore[list-item]
    session = service.session
    session.receive(imu(4, 1_000_000), HERE, NOW_US)
    assert not session.vehicles
    assert not len(session.peers)
    packet = theirs.sign(imu(4, 1_000_000))
    session.receive(packet, HERE, NOW_US)
    session.receive(packet, HERE, NOW_US)
    setup = payload(fields_of("SETUP_SIGNING"), secret_key=[9] * 32)
    session.receive(theirs.sign(frame(setup, 4, 1, 0)), HERE, NOW_US)
    assert list(session.vehicles) == [4]
    assert session.dropped["unsigned"] == session.dropped["timestamp seen before"] == 1
    session.tick(NOW_US + 1)
    assert wire.sent
    judge = Verifier(Key(SECRET), Clock(lambda: time.time_ns() // 1000))
    assert all(judge.check(scan(data), False).keep.all() for data, _ in wire.sent)
    service.close()
    # a recording holds neither signatures nor keys
    frames = read_tlog(tmp_path / "x.tlog")
    packets = [frames.packet(i) for i in range(len(frames))]
    assert imu(4, 1_000_000) in packets
    assert not any(is_signed(packet) for packet in packets)
    assert 256 not in frames.msgid


def test_each_link_has_its_own_policy(tmp_path: Path) -> None:
    signing = open_signing(tmp_path)
    links = [Wire(), Wire(), Wire()]
    service = Service(Config(), links, signing=signing, unsigned=["none", None, "all"])  # type: ignore[list-item]
    session = service.session
    for index, sysid in enumerate((4, 5, 6)):
        session.receive(imu(sysid, 1_000_000), (index, "127.0.0.1", 14550), NOW_US)
        session.receive(imu(sysid + 10, 1_000_000), (index, "10.0.0.9", 14550), NOW_US)
    assert list(session.vehicles) == [5, 6, 16]
    service.close()


def test_a_signature_allows_changes_from_elsewhere(tmp_path: Path) -> None:
    config = Config(signing=SigningSettings(unsigned="all"))
    service = Service(config, [Wire()], (), None, None, None, open_signing(tmp_path))  # type: ignore[list-item]
    session = service.session
    session.receive(origin(0), FAR, NOW_US)
    session.receive(signer(1).sign(origin(0)) + origin(0), FAR, NOW_US)
    assert not session._wanted_origins
    session.receive(signer(2).sign(origin(0)), FAR, NOW_US)
    assert len(session._wanted_origins) == 1
    service.close()


def test_the_gate_before_the_session() -> None:
    link = Queue([(b"noise" + imu(4, 1_000_000), FAR[1:]), (imu(4, 1_000_000), FAR[1:])])
    service = Service(Config(), [link])  # type: ignore[list-item]
    service._drain(0)
    assert list(service.session.vehicles) == [4]
    assert service._dropped() == {"no packet from an unknown address": 1}
    service._tick()
    assert link.preferred == [FAR[1:]]
    link.waiting = [(b"noise" + imu(4, 1_004_000), FAR[1:])]
    service._drain(0)
    assert service._dropped()["skipped bytes"] == 5
    service.close()


class Queue(Wire):
    """A link at which these datagrams wait."""

    def __init__(self, waiting: list[tuple[bytes, Any]]) -> None:
        super().__init__()
        self.waiting = waiting
        self.preferred: list[Any] = []

    def prefer(self, peers: list[Any]) -> None:
        self.preferred = list(peers)
