"""A live run and the replay of what it recorded give the same bytes, whatever the network did to the packets."""

from __future__ import annotations

import csv
import random
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

pytestmark = pytest.mark.jit

VEHICLE = (0, "127.0.0.1", 40_001)
OTHER = (0, "127.0.0.1", 40_003)
PEER = (0, "127.0.0.1", 40_002)
HIGHRES_IMU, GPS_RAW_INT, GLOBAL_POSITION_INT = 105, 24, 33
Arrival = tuple[int, Any, bytes]


def msgid(packet: bytes) -> int:
    return int.from_bytes(packet[7:10], "little")


def packed(message: Any, sysid: int = 255, compid: int = 190, seq: int = 0) -> bytes:
    link = dialect.MAVLink(None, sysid, compid)
    link.seq = seq
    return bytes(message.pack(link))


def peer_heartbeat(seq: int = 0) -> bytes:
    message = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    return packed(message, seq=seq)


def origin_request(target: int, lat: float) -> bytes:
    message = dialect.MAVLink_set_gps_global_origin_message(
        target, round(lat * 1e7), round(8.5456e7), 488_000
    )
    return packed(message)


def request_message(target: int, wanted: int) -> bytes:
    message = dialect.MAVLink_command_long_message(target, 1, 512, 0, wanted, 0, 0, 0, 0, 0, 0)
    return packed(message)


def reordered(stream: Iterable[Arrival], seed: int = 0) -> list[Arrival]:
    """A tenth of the IMU packets is up to 40 ms late, a few up to 1.5 s, some come twice or not at all."""
    rng = random.Random(seed)
    out: list[Arrival] = []
    for t_us, address, data in stream:
        delay = 0
        if msgid(data) == HIGHRES_IMU:
            kind = rng.random()
            if kind < 0.1:
                delay = rng.randrange(40_000)
            elif kind < 0.11:
                delay = rng.randrange(1_500_000)
            elif kind < 0.13:
                out.append((t_us + rng.randrange(20_000), address, data))
            elif kind < 0.15:
                continue
        out.append((t_us + delay, address, data))
    return out


def late_fixes(stream: Iterable[Arrival], delay_us: int, jitter_us: int = 0) -> list[Arrival]:
    rng = random.Random(1)
    late = (GPS_RAW_INT, GLOBAL_POSITION_INT)
    return [
        (t + (delay_us + rng.randrange(jitter_us + 1) if msgid(data) in late else 0), a, data)
        for t, a, data in stream
    ]


def with_peers(stream: list[Arrival]) -> list[Arrival]:
    """A ground station that sends heartbeats and requests in between."""
    start, end = stream[0][0], stream[-1][0]
    extra: list[Arrival] = []
    for k, t_us in enumerate(range(start, end, 70_000)):
        extra.append((t_us, PEER, peer_heartbeat(k % 256)))
        if k % 5 == 0:
            extra.append((t_us, PEER, request_message(100, 32)))
        if k % 7 == 0:
            extra.append((t_us, OTHER, request_message(1, 30)))
    return sorted([*stream, *extra], key=lambda item: item[0])


def grouped(stream: list[Arrival], seed: int = 2) -> list[Arrival]:
    """Several packets of one address in one datagram."""
    rng = random.Random(seed)
    out: list[Arrival] = []
    waiting: dict[Any, list[bytes]] = {}
    for t_us, address, data in sorted(stream, key=lambda item: item[0]):
        queue = waiting.setdefault(address, [])
        queue.append(data)
        if rng.random() < 0.3:
            out.append((t_us, address, b"".join(queue)))
            queue.clear()
    return out


def same(live: Path, replayed: Path, rows: int = 100) -> None:
    """Both result files are equal, byte for byte, and hold something."""
    for name in ("estimates.csv", "innovations.csv"):
        ours, theirs = (live / name).read_bytes(), (replayed / name).read_bytes()
        assert ours.count(b"\n") > rows, name
        assert ours == theirs, name


CASES: dict[str, Callable[[list[Arrival]], list[Arrival]]] = {
    "as sent": lambda s: s,
    "IMU reordered, doubled and lost": reordered,
    "GNSS late": lambda s: late_fixes(s, 200_000),
    "GNSS late and out of order": lambda s: late_fixes(s, 100_000, 450_000),
    "peers in between": with_peers,
    "several packets per datagram": grouped,
    "all together": lambda s: grouped(with_peers(late_fixes(reordered(s), 150_000, 100_000))),
}


@pytest.mark.parametrize("case", CASES)
def test_a_live_run_and_its_replay_give_the_same_bytes(case: str, rig: Any, fly: Any) -> None:
    rig.run(CASES[case](fly(9.0)))
    replayed = rig.replayed()
    same(rig.folder(), replayed, rows=20)
    assert len((rig.folder() / "estimates.csv").read_text().splitlines()) > 250


def test_two_vehicles_at_once(rig: Any, fly: Any) -> None:
    first = reordered(fly(8.0))
    second = late_fixes(fly(8.0, seed=5, sysid=7, address=OTHER), 120_000)
    second = [(t + 1_300, address, data) for t, address, data in second]
    rig.run(with_peers(first + second))
    assert set(rig.session.vehicles) == {1, 7}
    same(rig.folder(), rig.replayed(1), rows=20)
    same(rig.folder(7), rig.replayed(7), rows=20)


def test_origins_asked_for_on_the_way(rig: Any, fly: Any) -> None:
    """Requests take effect at their place in a datagram, for the one they are meant for, before a vehicle is there
    too."""
    stream = fly(9.0)
    start = stream[0][0]
    other = fly(8.0, seed=3, sysid=9, address=OTHER)
    other = [(t + 2_000_000 + 700, address, data) for t, address, data in other]
    requests: list[Arrival] = [
        (start - 1, PEER, origin_request(0, 47.40)),
        (start + 5_000_000, PEER, origin_request(100, 47.39)),
        (start + 6_000_000, PEER, origin_request(1, 47.30)),
        (start + 7_000_000, PEER, origin_request(108, 47.38)),
    ]
    # one datagram: samples, a request, samples
    at = next(i for i, item in enumerate(stream) if item[0] > start + 8_200_000)
    batch = stream[at : at + 6]
    data = [packet for _, _, packet in batch]
    whole = b"".join([*data[:3], origin_request(0, 47.37), *data[3:]])
    stream[at : at + 6] = [(batch[0][0], VEHICLE, whole)]
    rig.run(requests + stream + other)
    assert rig.vehicle(1).identity.sysid == 100
    assert rig.vehicle(9).identity.sysid == 108
    same(rig.folder(), rig.replayed(1), rows=20)
    same(rig.folder(9), rig.replayed(9), rows=20)
    origins = [m.latitude for m in rig.messages("GPS_GLOBAL_ORIGIN", VEHICLE, 100)]
    seen = list(dict.fromkeys(round(lat / 1e5) for lat in origins))
    assert seen == [4740, 4739, 4737]


@pytest.mark.parametrize("gap", [0.3, 1.0, 5.0])
def test_gaps_and_reboots(gap: float, rig: Any, fly: Any) -> None:
    stream = fly(9.0)
    start = stream[0][0]
    cut = [item for item in stream if not 0 <= item[0] - start - 3_500_000 < gap * 1e6]
    after = stream[-1][0] - start + 400_000
    rebooted = [(t + after, address, data) for t, address, data in fly(5.0, seed=4)]
    rig.run(cut + rebooted)
    assert rig.vehicle().intake.reboots == 1
    same(rig.folder(), rig.replayed(), rows=20)


def test_a_grid_row_is_the_first_sample_at_or_after_it(rig: Any, fly: Any) -> None:
    rig.run(fly(8.0))
    rig.close()
    with (rig.folder() / "estimates.csv").open() as file:
        stamps = [int(row["t_us"]) for row in csv.DictReader(file)]
    assert all(t % 20_000 == 0 for t in stamps)
    assert stamps == list(range(stamps[0], stamps[-1] + 1, 20_000))
