"""Packets out of a stream that is cut anywhere: the same as out of the whole, and no more is held than a packet."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import attitude, frame, heartbeat, highres_imu, scan, statustext
from mavins.mavlink.stream_buffer import PATIENCE_US, StreamBuffer
from mavins.types import ImuSample

LONGEST = 280

IMU = frame(highres_imu(ImuSample(1_000_000, np.array([0.1, 0.2, -9.8]), np.ones(3))), 1, 1, 7)
BEAT = frame(heartbeat(2, 3), 1, 1, 8)
TURN = frame(attitude(1_000_000, 0.1, 0.2, 0.3, (0.0, 0.0, 0.0)), 1, 1, 9)
TEXT = frame(statustext("a text", 6, 0)[0], 1, 1, 10)


def v1(message: dialect.MAVLink_message) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, 1, 1), force_mavlink1=True))


V1 = v1(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
# a packet that carries a whole other one
TUNNEL = bytes(
    dialect.MAVLink_tunnel_message(0, 0, 0, len(BEAT), list(BEAT.ljust(128, b"\0"))).pack(
        dialect.MAVLink(None, 1, 1)
    )
)
SIGNED = IMU[:2] + b"\x01" + IMU[3:]  # its checksum is wrong now: damage that is 13 bytes longer
UNKNOWN = b"\xfd\x05\x00\x00\x01\x01\x01\xee\xee\xee" + b"hello" + b"\x12\x34"
CLEAN = [IMU, BEAT, TURN, TEXT, V1, TUNNEL]

garbage = st.one_of(
    st.binary(max_size=60),
    st.sampled_from([b"\xfd", b"\xfe", b"\xfd\xff\x00\x00", b"\xfe\x09", SIGNED, UNKNOWN]),
    st.builds(lambda packet, n: packet[:n], st.sampled_from(CLEAN), st.integers(0, 60)),
    st.builds(lambda packet, n: packet[n:], st.sampled_from(CLEAN), st.integers(1, 60)),
)
streams = st.lists(st.one_of(st.sampled_from(CLEAN), garbage), max_size=12).map(b"".join)


def split(stream: bytes, cuts: list[int]) -> list[bytes]:
    places = [0, *sorted(cut % (len(stream) + 1) for cut in cuts), len(stream)]
    return [stream[a:b] for a, b in pairwise(places)]


def packets(data: bytes) -> list[bytes]:
    frames = scan(data)
    return [frames.packet(i) for i in range(len(frames))]


@given(streams, st.lists(st.integers(0, 4000), max_size=25))
def test_any_split_gives_the_packets_of_the_whole(stream: bytes, cuts: list[int]) -> None:
    buffer, got, handed = StreamBuffer(), [], b""
    for piece in split(stream, cuts):
        out = buffer.push(piece, 0)
        handed += out
        got += packets(out)
        assert len(stream) - len(handed) >= len(buffer._held) <= LONGEST
    rest = buffer.rest()
    assert got + packets(rest) == packets(stream)
    assert handed + rest == stream
    assert buffer.rest() == b""


@given(
    st.lists(st.sampled_from([*CLEAN, UNKNOWN]), max_size=12),
    st.lists(st.integers(0, 4000), max_size=25),
)
def test_a_clean_stream_shows_no_damage(parts: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(parts)
    buffer, unknown = StreamBuffer(), 0
    for piece in split(stream, cuts):
        damage = scan(buffer.push(piece, 0)).damage
        assert damage.skipped_bytes == damage.truncated == damage.bad_crc == 0
        unknown += damage.unknown
    assert buffer.rest() == b""
    assert unknown == parts.count(UNKNOWN)


@pytest.mark.parametrize("packet", CLEAN, ids=["imu", "beat", "turn", "text", "v1", "tunnel"])
def test_a_packet_byte_by_byte_comes_with_its_last_byte(packet: bytes) -> None:
    buffer = StreamBuffer()
    out = [buffer.push(packet[k : k + 1], k) for k in range(len(packet))]
    assert out == [b""] * (len(packet) - 1) + [packet]


@pytest.mark.parametrize(
    "noise",
    [
        b"\x00\x55\xaa" * 50,
        b"\xfd\xff\x00\x00\x01\x01\x01\xee\xee\xee\x00"[1:],
        b"x\xfd\xff\x7f\x00\x00",  # flags that no packet has
        b"x\xfd\xff\x00\x00\x01\x01\x01\xee\xee\xee",  # a message that there is not
        b"x\xfe\xff\x00\x01\x01\x00",  # a HEARTBEAT that is too long
    ],
)
def test_a_good_packet_after_garbage_is_used_at_once(noise: bytes) -> None:
    buffer = StreamBuffer()
    got = packets(buffer.push(noise, 0))
    got += packets(buffer.push(BEAT, 1))
    assert got == [BEAT]


def test_a_packet_whose_rest_was_lost_holds_up_others_for_a_moment_only() -> None:
    buffer = StreamBuffer()
    assert buffer.push(IMU[:20], 1_000) == b""
    assert buffer.push(BEAT, 2_000) == b""
    assert buffer.overdue(2_000 + PATIENCE_US // 2) == b""
    assert packets(buffer.overdue(1_001 + PATIENCE_US)) == [BEAT]
    assert packets(buffer.push(IMU, 3_000 + PATIENCE_US)) == [IMU]


def test_a_slow_line_loses_nothing() -> None:
    buffer = StreamBuffer()
    for k in range(0, len(IMU) - 1, 7):
        assert buffer.push(IMU[k : min(k + 7, len(IMU) - 1)], 1_000_000 * k) == b""
        assert buffer.overdue(1_000_000 * (k + 1)) == b""
    assert buffer.push(IMU[-1:], 900_000_000) == IMU
    assert buffer.overdue(2_000_000_000) == b""


@settings(max_examples=20)
@given(st.lists(st.binary(max_size=5000), max_size=20), st.integers(0, 50))
def test_garbage_without_end_is_not_kept(pieces: list[bytes], start_bytes: int) -> None:
    buffer = StreamBuffer()
    for k, piece in enumerate(pieces):
        buffer.push(piece.replace(b"a", b"\xfe") + b"\xfd" * start_bytes, 1000 * k)
        assert len(buffer._held) <= LONGEST
