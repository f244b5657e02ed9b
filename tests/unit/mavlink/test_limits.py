"""Who may send and how much: buckets against their definition, floods, networks, and who may change what."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavins import typed_settings
from mavins.errors import ConfigError
from mavins.mavlink.codec import frame, heartbeat
from mavins.mavlink.limits import (
    PIECE,
    REMEMBERED,
    AllowList,
    Bucket,
    Gate,
    LimitSettings,
    is_loopback,
    may_change,
    networks,
    starts_a_packet,
)
from mavins.mavlink.signing import Clock, Key, Signer

HELLO = frame(heartbeat(2, 3), 7, 1, 5)
SECOND = 1_000_000
NOW_US = 1_790_000_000_000_000
VEHICLE, STATION = (0, "10.0.0.1", 14550), (0, "10.0.0.2", 14550)


def settings(**values: object) -> LimitSettings:
    return LimitSettings(**values)  # type: ignore[arg-type]


def admitted(gate: Gate, address: tuple[int, str, int], now_us: int, data: bytes = HELLO) -> bool:
    return gate.admits(data, address, address[1], now_us)


# ---- buckets -------------------------------------------------------------------------------------


@given(st.integers(1, 1000), st.lists(st.integers(0, SECOND // 2), max_size=300))
def test_a_bucket_gives_its_rate_and_a_second_of_burst(rate: int, steps: list[int]) -> None:
    bucket, now_us, given = Bucket(rate, 0), 0, 0
    for step in steps:
        now_us += step
        given += bucket.take(now_us)
        assert given <= rate + rate * now_us / SECOND
    # and no less than that to one who asks for less
    patient = Bucket(rate, 0)
    assert all(patient.take(k * SECOND // rate + k) for k in range(3 * rate))


def test_pieces_of_a_stream_count_by_their_length() -> None:
    gate = Gate(settings(vehicle_rate=1000, peer_rate=10, unknown_rate=4), NOW_US)
    gate.know([VEHICLE], [STATION], NOW_US)
    piece = bytes(3 * PIECE - 1)
    assert [gate.admits_piece(piece, STATION, NOW_US) for _ in range(4)] == [True] * 3 + [False]
    assert all(gate.admits_piece(piece, VEHICLE, NOW_US) for _ in range(333))
    assert [gate.admits_piece(piece, (0, "10.9.9.9", k), NOW_US) for k in range(2)] == [True, False]
    assert gate.dropped == {"peer over its rate": 1, "unknown addresses over their rate": 1}
    assert gate.admits_piece(piece, STATION, NOW_US + SECOND)


def test_a_clock_that_steps_back_gives_nothing_and_takes_nothing() -> None:
    bucket = Bucket(1, NOW_US)
    assert bucket.take(NOW_US)
    assert not bucket.take(NOW_US - 10 * SECOND)
    assert not bucket.take(NOW_US)
    assert bucket.take(NOW_US + SECOND)


# ---- the gate ------------------------------------------------------------------------------------


def test_a_flood_of_fake_peers_leaves_known_ones_alone() -> None:
    gate = Gate(settings(unknown_rate=100), NOW_US)
    gate.know([VEHICLE], [VEHICLE, STATION], NOW_US)
    passed = 0
    for k in range(50_000):  # a second of it, each from another address
        now_us = NOW_US + k * 20
        passed += admitted(gate, (0, f"10.1.{k >> 8 & 255}.{k & 255}", k), now_us)
        if k % 50 == 0:
            assert admitted(gate, VEHICLE, now_us)
        if k % 100 == 0:
            assert admitted(gate, STATION, now_us)
    assert 100 <= passed <= 201
    assert gate.dropped == {"unknown addresses over their rate": 50_000 - passed}
    # nothing is kept of them
    assert len(gate._vehicles) + len(gate._peers) == 3
    assert len(gate._allowed._known) == 0


def test_garbage_costs_new_peers_nothing() -> None:
    gate = Gate(settings(unknown_rate=1), NOW_US)
    assert not any(admitted(gate, STATION, NOW_US, bytes(40)) for _ in range(1000))
    assert admitted(gate, STATION, NOW_US)
    assert gate.dropped == {"no packet from an unknown address": 1000}


def test_one_that_is_known_is_held_to_its_own_rate() -> None:
    gate = Gate(settings(vehicle_rate=300, peer_rate=20), NOW_US)
    gate.know([VEHICLE], [VEHICLE, STATION], NOW_US)
    # damage on its way is for the scanner to count
    assert sum(admitted(gate, VEHICLE, NOW_US, b"noise" + HELLO) for _ in range(1000)) == 300
    assert sum(admitted(gate, STATION, NOW_US) for _ in range(1000)) == 20
    assert gate.dropped == {"vehicle over its rate": 700, "peer over its rate": 980}
    # to be told again who is known fills no bucket
    gate.know([VEHICLE], [VEHICLE, STATION], NOW_US)
    assert not admitted(gate, VEHICLE, NOW_US)
    # who becomes a vehicle has its rate at once, who is forgotten is unknown
    gate.know([STATION], [STATION], NOW_US)
    assert admitted(gate, STATION, NOW_US)
    assert not admitted(gate, VEHICLE, NOW_US, b"noise" + HELLO)


@given(st.binary(max_size=300))
def test_no_bytes_raise_anything(data: bytes) -> None:
    gate = Gate(settings(), NOW_US)
    gate.know([VEHICLE], [VEHICLE], NOW_US)
    assert admitted(gate, VEHICLE, NOW_US, data)
    assert admitted(gate, STATION, NOW_US, data) == starts_a_packet(data)


def test_every_packet_starts_a_packet() -> None:
    signed = Signer(Key(bytes(range(32))), 0, Clock(lambda: NOW_US)).sign(HELLO)
    assert starts_a_packet(HELLO)
    assert starts_a_packet(HELLO + HELLO)
    assert starts_a_packet(signed)
    assert starts_a_packet(bytes((0xFE, 9, 0, 1, 1, 0)) + bytes(11))
    assert not starts_a_packet(HELLO[:-1])
    assert not starts_a_packet(b"x" + HELLO)
    assert not starts_a_packet(b"")


# ---- networks ------------------------------------------------------------------------------------


def test_an_allow_list() -> None:
    gate = Gate(settings(allow=("10.0.0.0/31", "fd00::/8")), NOW_US)
    hosts = {
        "10.0.0.1": True, "10.0.0.2": False, "127.0.0.1": True, "::1": True, "fd00::7": True,
        "fe80::1%eth0": False, "::ffff:10.0.0.1": True, "somewhere": False,
    }  # fmt: skip
    for host, allowed in hosts.items():
        for _ in range(2):
            assert admitted(gate, (0, host, 1), NOW_US) == allowed, host
    assert gate.dropped["address not on the allow-list"] == 2 * list(hosts.values()).count(False)


def test_no_list_allows_all() -> None:
    assert "10.0.0.1" in AllowList(())
    assert "::1" in AllowList(())


def test_what_an_allow_list_remembers_is_bounded() -> None:
    allowed = AllowList(networks(["10.0.0.0/8"]))
    assert all(f"10.0.{k >> 8}.{k & 255}" in allowed for k in range(3 * REMEMBERED))
    assert len(allowed._known) == REMEMBERED


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("10.0.0.0/33", "'10.0.0.0/33' is not a network"),
        ("lan", "'lan' is not a network: give ADDRESS or ADDRESS/BITS"),
        ("192.168.1.7/24", "'192.168.1.7/24' has host bits set: did you mean 192.168.1.0/24?"),
        ("", "'' is not a network"),
    ],
)
def test_a_bad_entry_is_one_line(entry: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        typed_settings.build(LimitSettings, {"allow": ["10.0.0.0/8", entry]}, "x.yaml")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_from_a_file() -> None:
    made = typed_settings.build(LimitSettings, {"allow": ["10.0.0.0/8"], "peer_rate": 5}, "x.yaml")
    assert made == settings(allow=("10.0.0.0/8",), peer_rate=5.0)
    with pytest.raises(ConfigError, match="unknown_rate"):
        typed_settings.build(LimitSettings, {"unknown_rate": 0}, "x.yaml")


# ---- who may change ------------------------------------------------------------------------------

LOOPBACK = ("127.0.0.1", "127.8.9.1", "::1", "::ffff:127.0.0.1")
ELSEWHERE = (
    "10.0.0.1",
    "128.0.0.1",
    "::2",
    "::ffff:10.0.0.1",
    "localhost",
    "",
    "127.0.0.1.evil.example",
)


@pytest.mark.parametrize("host", LOOPBACK)
def test_this_host_may_change(host: str) -> None:
    assert is_loopback(host)
    assert may_change(host, allow_remote=False)


@pytest.mark.parametrize("host", ELSEWHERE)
def test_others_may_change_if_allowed_or_signed(host: str) -> None:
    assert not is_loopback(host)
    assert not may_change(host, allow_remote=False)
    assert may_change(host, allow_remote=True)
    assert may_change(host, allow_remote=False, signed=True)
