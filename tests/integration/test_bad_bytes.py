"""Damaged, foreign and doubled packets: the service stays up, counts them, and uses every intact one around them."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import frame, heartbeat, scan

pytestmark = pytest.mark.jit

STRANGER = (0, "127.0.0.1", 40_009)
Arrival = tuple[int, Any, bytes]


@pytest.fixture
def clean(make_rig: Callable[..., Any], standing: Callable[..., Any]) -> tuple[list[Arrival], Any]:
    """A quiet flight as it should be, and its run."""
    stream = list(standing().packets(8.0))
    return stream, make_rig(name="clean").run(stream)


def files(rig: Any) -> dict[str, bytes]:
    rig.close()
    folder: Path = rig.folder()
    found = {name: (folder / name).read_bytes() for name in ("estimates.csv", "innovations.csv")}
    assert all(content.count(b"\n") > 20 for content in found.values())
    return found


def wrong_crc(packet: bytes, rng: random.Random) -> bytes:
    i = rng.randrange(10, len(packet))
    return packet[:i] + bytes([packet[i] ^ 1 << rng.randrange(8)]) + packet[i + 1 :]


def cut(packet: bytes, rng: random.Random) -> bytes:
    return packet[: rng.randrange(1, len(packet))]


def noise(packet: bytes, rng: random.Random) -> bytes:
    return rng.randbytes(rng.randrange(1, 60))


def unknown(packet: bytes, rng: random.Random) -> bytes:
    """A well-formed packet with an id that no dialect has."""
    return bytes([0xFD, 4, 0, 0, 9, 1, 1, 0x3F, 0x42, 0x0F]) + rng.randbytes(6)


def alone(bad: bytes, good: bytes) -> list[bytes]:
    return [bad, good]


def before(bad: bytes, good: bytes) -> list[bytes]:
    return [bad + good]


def after(bad: bytes, good: bytes) -> list[bytes]:
    return [good + bad]


@pytest.mark.parametrize("place", [alone, before, after])
@pytest.mark.parametrize(
    ("damage", "counter"),
    [
        (noise, "skipped bytes"),
        (cut, "skipped bytes"),
        (wrong_crc, "bad crc"),
        (unknown, "unknown"),
    ],
)
def test_every_intact_packet_around_damage_is_used(
    damage: Callable[[bytes, random.Random], bytes],
    counter: str,
    place: Callable[[bytes, bytes], list[bytes]],
    clean: tuple[list[Arrival], Any],
    make_rig: Callable[..., Any],
) -> None:
    stream, expected = clean
    rng = random.Random(7)
    rig = make_rig()
    damaged = 0
    for now_us, address, good in stream:
        datagrams = [good]
        if rng.random() < 0.3:
            datagrams = place(damage(good, rng), good)
            damaged += 1
        for data in datagrams:
            rig.receive(now_us, address, data)
    assert rig.session.packets_in == len(stream)
    dropped = rig.session.dropped
    if damage is noise or damage is cut:
        assert dropped[counter] >= damaged
    else:
        assert dropped[counter] == pytest.approx(damaged, rel=0.1)
    assert files(rig) == files(expected)


def test_halves_of_two_packets_in_one_datagram(
    clean: tuple[list[Arrival], Any], make_rig: Callable[..., Any]
) -> None:
    stream, expected = clean
    rig = make_rig()
    for k, (now_us, address, good) in enumerate(stream):
        other = stream[k - 1][2]
        data = other[: len(other) // 2] + good + other[len(other) // 2 :] if k % 3 else good
        rig.receive(now_us, address, data)
    assert rig.session.packets_in == len(stream)
    assert files(rig) == files(expected)


def test_every_cut_of_every_packet_before_another_one() -> None:
    """What is left of a packet and the next one together must not pass for one of an unknown kind."""
    parts = [frame(heartbeat(2, 12), 1, 1, k) for k in range(0, 256, 20)]
    parts += [frame(heartbeat(2, 0), sysid, 190, 253) for sysid in (253, 254)]
    for packet, good in itertools.product(parts, parts):
        for length in range(1, len(packet)):
            frames = scan(packet[:length] + good)
            assert len(frames) == 1, (packet[:length].hex(), good.hex())
            assert frames.packet(0) == good


def test_empty_and_huge_datagrams(
    clean: tuple[list[Arrival], Any], make_rig: Callable[..., Any]
) -> None:
    stream, expected = clean
    rng = random.Random(3)
    rig = make_rig()
    for k, (now_us, address, good) in enumerate(stream):
        if k % 40 == 0:
            rig.receive(now_us, address, b"")
            rig.receive(now_us, STRANGER, rng.randbytes(65_507))
            rig.receive(now_us, STRANGER, b"\xfd" * 65_507)
        rig.receive(now_us, address, good)
    assert STRANGER not in rig.session.peers
    assert files(rig) == files(expected)


def test_every_packet_twice_and_old_ones_again(
    clean: tuple[list[Arrival], Any], make_rig: Callable[..., Any]
) -> None:
    """A doubled sample, fix or heading is used once, however late its double is."""
    stream, expected = clean
    rig = make_rig()
    for k, (now_us, address, good) in enumerate(stream):
        rig.receive(now_us, address, good)
        rig.receive(now_us, address, good)
        if k > 30 and k % 7 == 0:
            rig.receive(now_us, address, stream[k - 25][2])
    dropped = rig.vehicle().estimator.dropped + rig.vehicle().intake.dropped
    assert dropped["IMU repeated"] > 300
    assert dropped["GLOBAL_POSITION_INT repeated stamp"] > 30
    assert dropped["ATTITUDE repeated stamp"] > 60
    assert files(rig) == files(expected)


def test_our_own_packets_coming_back(
    clean: tuple[list[Arrival], Any], make_rig: Callable[..., Any]
) -> None:
    """A router that sends everything to everyone: what we said is no news to us, least of all a heading."""
    stream, expected = clean
    rig = make_rig()
    said: list[bytes] = []
    rig.tap = said.append
    returned = 0
    for now_us, address, good in stream:
        rig.receive(now_us, address, good)
        for k, data in enumerate(said):
            rig.session.receive(data, (address, STRANGER)[k % 2], now_us)
        returned += len(said)
        said.clear()
    assert returned > 500
    assert rig.session.dropped["our own packets"] == returned
    assert STRANGER not in rig.session.peers
    assert set(rig.session.vehicles) == {1}
    assert files(rig) == files(expected)


def test_a_second_vehicle_with_the_same_sysid(
    clean: tuple[list[Arrival], Any], make_rig: Callable[..., Any], standing: Callable[..., Any]
) -> None:
    """The first address keeps the sysid; when it has been silent for 3 s, the second one gets it."""
    stream, expected = clean
    impostor = standing(address=STRANGER, boot_us=1_200_000)
    impostor.lat += 1e-3
    impostor.unix_us += 1_000_000
    foreign = list(impostor.packets(6.0))
    rig = make_rig().run([*stream, *foreign])
    dropped = rig.session.dropped["sysid 1 from another address"]
    assert dropped == len(foreign)
    assert STRANGER not in rig.session.peers
    assert files(rig) == files(expected)


def test_a_sysid_changes_hands_after_three_seconds(
    make_rig: Callable[..., Any], standing: Callable[..., Any]
) -> None:
    rig = make_rig()
    rig.run(standing().packets(6.0))
    last_us = rig.now_us
    heir = standing(address=STRANGER)
    heir.lat += 1e-4
    heir.unix_us = last_us + 100_000 - heir.t_us
    rig.run(heir.packets(9.0))
    vehicle = rig.vehicle()
    assert vehicle.holder.address == STRANGER
    first = min(t for t, to, m in rig.sent if to == STRANGER)
    assert 2.9e6 <= first - last_us <= 3.2e6
    assert vehicle.estimator.running
    assert vehicle.intake.reboots == 1
    assert vehicle.estimator.solution().lat == pytest.approx(heir.lat, abs=1e-7)
    assert "mavins: vehicle 1 silent" not in rig.texts(STRANGER)
    rig.close()


def test_heartbeats_alone_make_a_peer_and_no_vehicle(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    for k in range(250):
        rig.receive(rig.now_us + 10_000, STRANGER, frame(heartbeat(6, 8), k + 1, 190, 0))
    assert rig.session.vehicles == {}
    assert set(rig.session.peers) == {STRANGER}
    rig.close()


def test_packets_of_mavlink_1_and_signed_ones_are_taken(
    make_rig: Callable[..., Any], standing: Callable[..., Any]
) -> None:
    one, two = dialect.MAVLink(None, 1, 1), dialect.MAVLink(None, 1, 1)
    two.signing.secret_key = b"k" * 32
    two.signing.sign_outgoing = True
    two.signing.timestamp = 1
    rig = make_rig()
    parser = dialect.MAVLink(None)
    for k, (now_us, address, good) in enumerate(standing().packets(5.0)):
        link = (one, two)[k % 2]
        packed = parser.decode(bytearray(good)).pack(link, force_mavlink1=link is one)
        rig.receive(now_us, address, bytes(packed))
    assert rig.vehicle().estimator.running
    assert not rig.session.dropped
    rig.close()
