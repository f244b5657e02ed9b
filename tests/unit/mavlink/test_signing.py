"""Signatures: the same bytes as pymavlink's, and what is taken of whom, when, and only once."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Payload, fields_of, frame, heartbeat, payload, scan, system_time
from mavins.mavlink.signing import (
    EPOCH_UNIX_US,
    LATEST,
    MAX_STREAMS,
    RADIO_STATUS,
    SETUP_SIGNING,
    SIGNED,
    STALE,
    TAIL,
    Clock,
    Key,
    Signer,
    Verifier,
    is_signed,
    takes_unsigned,
    ticks,
    unsigned,
    without_secrets,
)

SECRET = bytes(range(1, 33))
NOW_US = 1_790_000_000_000_000
NOW = ticks(NOW_US)
HELLO = frame(heartbeat(2, 3), 7, 1, 5)
RADIO = frame(payload(fields_of("RADIO_STATUS"), rssi=200), 51, 68, 0)

secrets = st.binary(min_size=32, max_size=32)
payloads = st.builds(system_time, st.integers(0, 2**62), st.integers(0, 2**31 * 1000)) | st.just(
    heartbeat(2, 3)
)
stamps = st.integers(1, LATEST)


def signer(timestamp: int = NOW, link_id: int = 0, secret: bytes = SECRET) -> Signer:
    """The first packet that it signs has `timestamp`."""
    return Signer(Key(secret), link_id, Clock(lambda: 0, timestamp - 1))


def verifier(now_us: int = NOW_US, secret: bytes = SECRET) -> Verifier:
    return Verifier(Key(secret), Clock(lambda: now_us))


def refused(judge: Verifier, *packets: bytes, takes: bool = False) -> list[str]:
    """The reasons against each datagram ('' for one that is kept)."""
    reasons = []
    for packet in packets:
        verdict = judge.check(scan(packet), takes)
        reasons.append(next(iter(verdict.refused), ""))
    return reasons


def oracle(timestamp: int = NOW, link_id: int = 0, secret: bytes = SECRET) -> Any:
    link = dialect.MAVLink(None, 7, 1)
    link.signing.secret_key = secret
    link.signing.timestamp = timestamp
    link.signing.link_id = link_id
    link.signing.sign_outgoing = True
    return link


# ---- against pymavlink ---------------------------------------------------------------------------


@given(payloads, secrets, stamps, st.integers(0, 255), st.integers(0, 255))
def test_pymavlink_takes_ours(
    message: Payload, secret: bytes, timestamp: int, link_id: int, seq: int
) -> None:
    for incompat in (0, SIGNED):
        packet = frame(message, 7, 1, seq, incompat)
        signed = signer(timestamp, link_id, secret).sign(packet)
        link = oracle(timestamp, link_id, secret)
        decoded = link.decode(bytearray(signed))
        assert decoded.get_msgId() == message.msgid
        assert decoded.get_signed()
        # and would have made the same bytes
        again = oracle(timestamp, link_id, secret)
        again.seq = seq
        assert decoded.pack(again) == signed


@given(payloads, secrets, stamps, st.integers(0, 255))
def test_ours_takes_pymavlinks(
    message: Payload, secret: bytes, timestamp: int, link_id: int
) -> None:
    link = oracle(timestamp, link_id, secret)
    plain = dialect.MAVLink(None).decode(bytearray(frame(message, 7, 1, 0)))
    judge = Verifier(Key(secret), Clock(lambda: 0, timestamp))
    verdict = judge.check(scan(plain.pack(link)), False)
    assert verdict.keep.tolist() == verdict.signed.tolist() == [True]
    assert judge.streams == {(link_id, 7, 1): timestamp}


@given(
    st.integers(0, len(HELLO) + TAIL - 1), st.integers(1, 255), st.binary(min_size=32, max_size=32)
)
def test_neither_takes_what_was_changed_or_signed_by_another(
    at: int, change: int, secret: bytes
) -> None:
    signed = bytearray(signer().sign(HELLO))
    signed[at] ^= change
    judge = verifier()
    assert not judge.check(scan(bytes(signed)), False).keep.any()
    if at not in (7, 8, 9):  # a message that pymavlink does not know it hands out unverified
        with pytest.raises(dialect.MAVError):
            oracle().decode(signed)
    if secret != SECRET:
        other = signer(secret=secret).sign(HELLO)
        # not even where unsigned ones are taken
        assert refused(judge, other, takes=True) == ["wrong signature"]
    assert judge.streams == {}
    assert refused(judge, signer().sign(HELLO)) == [""]


def test_a_packet_that_was_signed_for_a_recording() -> None:
    signed = signer().sign(HELLO)
    assert is_signed(signed)
    assert unsigned(signed) == HELLO
    assert unsigned(HELLO) == HELLO
    assert scan(signed).packet(0) == signed
    old = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3).pack(
        dialect.MAVLink(None), force_mavlink1=True
    )
    assert not is_signed(old)
    assert unsigned(old) == old


# ---- time ----------------------------------------------------------------------------------------


def test_timestamps_count_ten_microseconds_since_2015() -> None:
    assert ticks(EPOCH_UNIX_US) == 0
    assert ticks(EPOCH_UNIX_US + 60_000_000) == STALE
    assert ticks(0) == 0


@given(st.lists(st.integers(NOW_US - 10**8, NOW_US + 10**8), min_size=2), st.integers(0, 2 * NOW))
def test_our_timestamps_rise_whatever_the_clock_does(times: list[int], stored: int) -> None:
    left = iter(times)
    clock = Clock(lambda: next(left), stored)
    made = [clock.next() for _ in times]
    assert all(b > a for a, b in zip([stored, *made], made, strict=False))
    assert made[0] == max(stored + 1, ticks(times[0]))


def test_the_timestamp_follows_that_of_others_but_only_of_right_signatures() -> None:
    clock = Clock(lambda: NOW_US)
    judge = Verifier(Key(SECRET), clock)
    ahead = NOW + 12_345
    forged = signer(ahead + 7, secret=bytes(32)).sign(HELLO)
    judge.check(scan(forged), False)
    assert clock.now() == NOW
    judge.check(scan(signer(ahead).sign(HELLO)), False)
    assert clock.now() == ahead
    assert clock.next() == ahead + 1


def test_a_timestamp_that_would_leave_none_to_us_is_refused() -> None:
    assert refused(verifier(), signer(LATEST + 1).sign(HELLO)) == ["timestamp out of range"]
    assert refused(verifier(), signer(LATEST).sign(HELLO)) == [""]


@pytest.mark.parametrize(
    ("behind", "reason"), [(STALE, ""), (STALE + 1, "new stream with an old timestamp")]
)
def test_a_new_stream_may_be_a_minute_behind(behind: int, reason: str) -> None:
    assert refused(verifier(), signer(NOW - behind).sign(HELLO)) == [reason]


def test_a_known_stream_may_be_as_slow_as_it_likes() -> None:
    clock_us = [NOW_US]
    judge = Verifier(Key(SECRET), Clock(lambda: clock_us[0]))
    assert refused(judge, signer(NOW).sign(HELLO)) == [""]
    clock_us[0] += 10**9
    assert refused(judge, signer(NOW + 1).sign(HELLO)) == [""]


# ---- replays -------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 50), min_size=1, max_size=40))
def test_each_stream_rises_strictly(offsets: list[int]) -> None:
    judge = verifier()
    packets = [signer(NOW + k).sign(HELLO) for k in offsets]
    kept = [k for k, r in zip(offsets, refused(judge, *packets), strict=True) if not r]
    assert all(b > a for a, b in itertools.pairwise(kept))
    assert kept[-1] == max(offsets)
    # all of it once more: nothing
    assert set(refused(judge, *packets)) == {"timestamp seen before"}


def test_streams_are_told_apart_by_link_system_and_component() -> None:
    judge = verifier()
    for link_id, sysid, compid in ((0, 7, 1), (1, 7, 1), (0, 8, 1), (0, 7, 2)):
        packet = signer(NOW, link_id).sign(frame(heartbeat(2, 3), sysid, compid, 0))
        assert refused(judge, packet, packet) == ["", "timestamp seen before"]
    assert len(judge.streams) == 4


def test_what_was_taken_before_a_restart_is_not_taken_after_it() -> None:
    before, packet = verifier(), signer(NOW).sign(HELLO)
    assert refused(before, packet) == [""]
    after = Verifier(Key(SECRET), Clock(lambda: NOW_US), before.streams)
    assert refused(after, packet, signer(NOW + 1).sign(HELLO)) == ["timestamp seen before", ""]


def test_a_packet_twice_in_one_datagram() -> None:
    packet = signer(NOW).sign(HELLO)
    verdict = verifier().check(scan(packet + packet), False)
    assert verdict.keep.tolist() == [True, False]
    assert verdict.refused == {"timestamp seen before": 1}


def test_streams_are_bounded() -> None:
    judge = verifier()
    for k in range(MAX_STREAMS + 1):
        packet = signer(NOW, k >> 8).sign(frame(heartbeat(2, 3), k & 0xFF, 1, 0))
        assert refused(judge, packet) == ["" if k < MAX_STREAMS else "too many signed streams"]
    assert len(judge.streams) == MAX_STREAMS
    assert refused(judge, signer(NOW + 1).sign(frame(heartbeat(2, 3), 0, 1, 0))) == [""]


# ---- policies ------------------------------------------------------------------------------------


def test_unsigned_packets_by_policy() -> None:
    assert [takes_unsigned(p, True) for p in ("none", "local", "all")] == [False, True, True]
    assert [takes_unsigned(p, False) for p in ("none", "local", "all")] == [False, False, True]
    judge = verifier()
    assert refused(judge, HELLO) == ["unsigned"]
    assert refused(judge, HELLO, takes=True) == [""]
    assert not judge.check(scan(HELLO), True).signed.any()


def test_a_radio_need_not_sign_but_may_not_lie() -> None:
    assert scan(RADIO).msgid[0] == RADIO_STATUS
    assert refused(verifier(), RADIO) == [""]
    assert refused(verifier(), signer(secret=bytes(32)).sign(RADIO)) == ["wrong signature"]


def test_a_datagram_of_all_kinds() -> None:
    signed = signer().sign(HELLO)
    wrong = signer(secret=bytes(32)).sign(HELLO)
    verdict = verifier().check(scan(HELLO + signed + wrong + RADIO), False)
    assert verdict.keep.tolist() == [False, True, False, True]
    assert verdict.signed.tolist() == [False, True, False, False]
    assert verdict.refused == {"unsigned": 1, "wrong signature": 1}


@given(st.binary(max_size=400), st.booleans())
def test_garbage_raises_nothing(data: bytes, takes: bool) -> None:
    frames = scan(data)
    verdict = verifier().check(frames, takes)
    assert len(verdict.keep) == len(frames)
    assert (verdict.keep.sum() + sum(verdict.refused.values())) == len(frames)


# ---- the key -------------------------------------------------------------------------------------


def test_setup_signing_goes_nowhere() -> None:
    setup = payload(fields_of("SETUP_SIGNING"), target_system=100, secret_key=[9] * 32)
    packet = frame(setup, 255, 190, 0)
    frames = without_secrets(scan(HELLO + packet + HELLO))
    assert SETUP_SIGNING not in frames.msgid
    assert len(frames) == 2
    plain = scan(HELLO)
    assert without_secrets(plain) is plain


def test_a_key_does_not_show_itself() -> None:
    key = Key(SECRET)
    texts = [repr(key), str(key), repr(signer()), repr(verifier()), str(vars(verifier()))]
    assert all(SECRET.hex() not in text and repr(SECRET) not in text for text in texts)
    with pytest.raises(TypeError):
        pickle.dumps(key)
    with pytest.raises(ValueError, match="32 bytes, not 5"):
        Key(b"short")


def test_masks_are_of_the_length_of_the_frames() -> None:
    verdict = verifier().check(scan(b""), False)
    assert verdict.keep.dtype == np.bool_
    assert len(verdict.keep) == len(verdict.signed) == 0
