"""Intact packets are found whatever lies around them; nothing raises, damage is counted."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Damage, frame, heartbeat, scan, scan_tlog
from mavins.mavlink.codec.encode import attitude, system_time


def packets(n: int, start: int = 0) -> list[bytes]:
    """n different packets of three lengths."""
    made = []
    for k in range(start, start + n):
        turning = attitude(k * 1000 + 5000, 0.1, -0.2, 0.3 + k, (1.0, 2.0, k))
        message = (heartbeat(2, 3), turning, system_time(k, k))[k % 3]
        made.append(frame(message, 1 + k % 5, 1, k))
    return made


def unknown_packet(body: bytes = b"\1\2\3\4", msgid: int = 0xFFFFF0) -> bytes:
    """A well-formed packet of an id that no dialect has."""
    head = bytes([0xFD, len(body), 0, 0, 9, 1, 1]) + msgid.to_bytes(3, "little")
    return head + body + b"\x12\x34"


def found(data: bytes) -> list[bytes]:
    frames = scan(data)
    return [frames.packet(i) for i in range(len(frames))]


def is_subsequence(wanted: list[bytes], within: list[bytes]) -> bool:
    rest = iter(within)
    return all(packet in rest for packet in wanted)


# garbage that cannot by itself be a packet start
quiet_garbage = st.binary(max_size=60).map(
    lambda garbage: garbage.replace(b"\xfd", b"x").replace(b"\xfe", b"y")
)


def test_an_empty_buffer_holds_nothing() -> None:
    assert len(scan(b"")) == 0
    assert not scan(b"").damage


def test_one_packet_after_another() -> None:
    sent = packets(30)
    frames = scan(b"".join(sent))
    assert [frames.packet(i) for i in range(len(frames))] == sent
    assert frames.seq.tolist() == list(range(30))
    assert not frames.damage


def test_all_packets_of_a_datagram_have_its_reception_stamp() -> None:
    assert scan(b"".join(packets(3)), received_us=123).t_us.tolist() == [123] * 3
    assert scan(packets(1)[0]).t_us.tolist() == [0]


def test_every_kind_of_buffer_reads_alike() -> None:
    data = b"".join(packets(3))
    array = np.frombuffer(data, np.uint8).copy()
    for buffer in (bytearray(data), memoryview(data), array):
        assert (scan(buffer).table == scan(data).table).all()
    array[0] = 0  # the caller's array stays writable
    assert len(scan(array)) == 2


@given(st.lists(quiet_garbage, min_size=4, max_size=4))
@settings(deadline=None)
def test_garbage_between_packets_costs_no_packet(garbage: list[bytes]) -> None:
    sent = packets(3)
    data = garbage[0] + sent[0] + garbage[1] + sent[1] + garbage[2] + sent[2] + garbage[3]
    frames = scan(data)
    assert [frames.packet(i) for i in range(len(frames))] == sent
    assert frames.damage.skipped_bytes == sum(map(len, garbage))


@given(st.binary(max_size=400))
@settings(deadline=None)
def test_random_bytes_never_raise_and_every_byte_is_accounted_for(data: bytes) -> None:
    for frames in (scan(data), scan_tlog(data)):
        inside = int((frames.end - frames.start).sum())
        assert inside + frames.damage.skipped_bytes <= len(data)
        assert (frames.start[1:] >= frames.end[:-1]).all()


@given(st.data())
@settings(deadline=None)
def test_damaged_packets_cost_only_themselves(data: st.DataObject) -> None:
    sent = packets(data.draw(st.integers(1, 8)))
    wire, intact = [], []
    for packet in sent:
        fate = data.draw(st.sampled_from(["intact", "intact", "flip", "cut", "splice"]))
        if fate == "flip":
            at = data.draw(st.integers(0, len(packet) - 1))
            bit = data.draw(st.integers(0, 7))
            wire.append(packet[:at] + bytes([packet[at] ^ 1 << bit]) + packet[at + 1 :])
        elif fate == "cut":
            wire.append(packet[: data.draw(st.integers(0, len(packet) - 1))])
        elif fate == "splice":
            wire.append(packet[: len(packet) // 2] + packet)
            intact.append(packet)
        else:
            wire.append(packet)
            intact.append(packet)
    # an id turned into an unknown one cannot be told from a message that we do not know
    frames = scan(b"".join(wire))
    read = [frames.packet(i) for i in range(len(frames))]
    if frames.damage.unknown == 0:
        assert is_subsequence(intact, read)
        assert len(read) == len(intact)
    else:
        assert len(read) >= len(intact) - frames.damage.unknown


def test_every_single_bit_flip_is_noticed_and_spares_the_neighbours() -> None:
    before, victim, after = packets(3)
    for at in range(8 * len(victim)):
        flipped = bytearray(victim)
        flipped[at // 8] ^= 1 << at % 8
        frames = scan(before + bytes(flipped) + after)
        read = [frames.packet(i) for i in range(len(frames))]
        assert read == [before, after], at
        assert frames.damage, at


def test_every_truncation_spares_what_follows() -> None:
    victim, after = packets(2)
    for length in range(1, len(victim)):
        assert found(victim[:length] + after) == [after], length
        # alone in its datagram it is one truncated packet, and nothing else suffers
        frames = scan(victim[:length])
        assert len(frames) == 0
        assert frames.damage == Damage(truncated=1, skipped_bytes=length)


def test_damage_is_counted_in_packets_and_bytes() -> None:
    a, b, c = packets(3)
    broken = b[:-1] + bytes([b[-1] ^ 0xFF])
    assert scan(a + broken + c).damage == Damage(bad_crc=1, skipped_bytes=len(b))
    assert scan(a + broken + broken + c).damage == Damage(bad_crc=2, skipped_bytes=2 * len(b))


def test_an_unknown_message_is_counted_and_stepped_over() -> None:
    a, b = packets(2)
    for data in (a + unknown_packet() + b, a + b + unknown_packet(), unknown_packet() + a + b):
        frames = scan(data)
        assert len(frames) == 2
        assert frames.damage == Damage(unknown=1)


def test_a_false_unknown_start_does_not_swallow_good_packets() -> None:
    good = packets(4)
    # a header that claims an unknown message reaching into the middle of a good packet
    lie = bytes([0xFD, len(good[0]) + 5, 0, 0, 9, 1, 1, 0xF0, 0xFF, 0xFF])
    assert found(lie + b"".join(good)) == good


def test_flags_that_we_cannot_honour_make_a_packet_unreadable() -> None:
    packet = bytearray(packets(1)[0])
    packet[2] = 0x02
    crc = dialect.x25crc(bytes(packet[1:-2]))
    crc.accumulate(bytes([50]))
    packet[-2:] = crc.crc.to_bytes(2, "little")
    assert found(bytes(packet)) == []


def test_a_later_version_of_a_message_is_cut_to_what_we_know() -> None:
    body = bytes(range(1, 10)) + b"\x55" * 4  # HEARTBEAT with four bytes of future extensions
    head = bytes([0xFD, len(body), 0, 0, 1, 1, 1, 0, 0, 0])
    crc = dialect.x25crc(head[1:] + body)
    crc.accumulate(bytes([50]))
    frames = scan(head + body + crc.crc.to_bytes(2, "little"))
    assert len(frames) == 1
    assert frames.body(0, 9) == body[:9]


def test_select_keeps_the_buffer() -> None:
    frames = scan(b"".join(packets(6)))
    chosen = frames.select(frames.msgid == 0)
    assert len(chosen) == 2
    assert chosen.packet(1) == frames.packet(3)


class TestTlog:
    """The same walk with eight bytes of stamp before each packet."""

    def log(self, stamps: list[int]) -> list[bytes]:
        return [t.to_bytes(8, "big") + p for t, p in zip(stamps, packets(len(stamps)), strict=True)]

    def test_stamps_go_with_their_packets(self) -> None:
        stamps = [1_700_000_000_000_000 + 4000 * k for k in range(9)]
        frames = scan_tlog(b"".join(self.log(stamps)))
        assert frames.t_us.tolist() == stamps
        assert not frames.damage

    @pytest.mark.parametrize("seed", range(5))
    def test_damage_costs_only_what_it_touches(self, seed: int) -> None:
        rng = random.Random(seed)
        stamps = [1_700_000_000_000_000 + 4000 * k for k in range(200)]
        records = self.log(stamps)
        hurt = set(rng.sample(range(200), 20))
        # half of the record lost: stamp and head, or tail
        wire = [
            (r[: len(r) // 2] if rng.random() < 0.5 else r[len(r) // 2 :]) if k in hurt else r
            for k, r in enumerate(records)
        ]
        frames = scan_tlog(b"".join(wire))
        assert frames.t_us.tolist() == [t for k, t in enumerate(stamps) if k not in hurt]

    def test_a_log_that_was_cut_off_gives_all_before(self) -> None:
        data = b"".join(self.log([1000, 2000, 3000]))
        frames = scan_tlog(data[:-3])
        assert frames.t_us.tolist() == [1000, 2000]
        assert frames.damage.truncated == 1

    def test_a_packet_without_its_whole_stamp_takes_the_one_before(self) -> None:
        first, second, third = self.log([1000, 2000, 3000])
        frames = scan_tlog(first + second[5:] + third)
        assert frames.t_us.tolist() == [1000, 1000, 3000]

    def test_an_unknown_message_is_stepped_over(self) -> None:
        first, second = self.log([1000, 2000])
        frames = scan_tlog(first + (1500).to_bytes(8, "big") + unknown_packet() + second)
        assert frames.t_us.tolist() == [1000, 2000]
        assert frames.damage == Damage(unknown=1)
