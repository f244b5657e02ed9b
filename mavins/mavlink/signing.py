"""MAVLink 2 message signing, sans I/O: key, time and what was kept of the last run are handed in.

    signature = sha256(key + header + payload + crc + link id + timestamp)[:6]

The timestamp counts 10 us since 2015-01-01. Each packet that we sign has a later one than all before, and of each
stream (link id, sysid, compid) only packets with a later one than the last are taken, so a replay is refused. A
signature says who sent a packet, it hides nothing. Rules: https://mavlink.io/en/guide/message_signing.html; what is
accepted from whom: docs/security.md.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal, TypeAlias

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from mavins.documented import Doc
from mavins.mavlink.codec.fields import WIRE
from mavins.mavlink.codec.framing import STX_V2, Frames

KEY_LENGTH: Final = 32
SIGNED: Final = 0x01
"""The bit of the incompatibility flags that a signed packet has."""
TAIL: Final = 13
"""Bytes after the checksum of a signed packet: link id, six of timestamp, six of signature."""
SETUP_SIGNING: Final = 256
RADIO_STATUS: Final = 109
EPOCH_UNIX_US: Final = 1_420_070_400_000_000
"""2015-01-01 00:00 UTC, where timestamps begin."""
TICK_US: Final = 10
STALE: Final = 6_000_000
"""A new stream may be this many ticks (a minute) behind us, not more."""
LATEST: Final = 2**48 - 2**40
"""A later timestamp (2100) is refused: adopted, it would leave us none to count on with."""
MAX_STREAMS: Final = 1024

_HEADER: Final = 10
_FLAGS: Final = 2
_SIGNATURE: Final = 6

Stream: TypeAlias = tuple[int, int, int]
"""(link id, sysid, compid): whose timestamps must rise."""
Unsigned: TypeAlias = Literal["none", "local", "all"]


@dataclass(frozen=True, slots=True)
class SigningSettings:
    """What is taken without a signature while there is a key (`--signing-key-file`)."""

    unsigned: Annotated[
        Unsigned,
        Doc(
            "Unsigned packets that are taken: none, those of this host and of trusted links, or all. "
            "RADIO_STATUS always is, a wrong signature never."
        ),
    ] = "local"


def takes_unsigned(policy: Unsigned, is_local: bool) -> bool:
    """Whether a link's policy takes unsigned packets from an address on this host, or on another."""
    return policy == "all" or (policy == "local" and is_local)


class Key:
    """The shared secret of 32 bytes. It cannot be read back, so that no text or log can hold it."""

    __slots__ = ("_seeded",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != KEY_LENGTH:
            raise ValueError(f"a signing key has {KEY_LENGTH} bytes, not {len(secret)}")
        self._seeded = hashlib.sha256(secret)

    def signature(self, data: bytes) -> bytes:
        """The six bytes for a packet up to and including its timestamp."""
        digest = self._seeded.copy()
        digest.update(data)
        return digest.digest()[:_SIGNATURE]


@dataclass(frozen=True, slots=True)
class Memory:
    """What outlives a run: a timestamp that was not used yet, and the last one of each stream."""

    timestamp: int = 0
    streams: Mapping[Stream, int] = field(default_factory=dict)


def ticks(unix_us: int) -> int:
    """Microseconds since 1970 -> timestamp; zero before 2015."""
    return max(0, unix_us - EPOCH_UNIX_US) // TICK_US


class Clock:
    """The local timestamp: the greatest of the time `unix_us()`, of those used and of those seen.

    The time is asked for anew each time: a computer without a battery clock learns it after its start.
    """

    def __init__(self, unix_us: Callable[[], int], timestamp: int = 0) -> None:
        self._unix_us = unix_us
        self._last = timestamp

    def now(self) -> int:
        """The local timestamp."""
        return max(self._last, ticks(self._unix_us()))

    def next(self) -> int:
        """A timestamp later than all before."""
        self._last = max(self._last + 1, ticks(self._unix_us()))
        return self._last

    def see(self, timestamp: int) -> None:
        """Go on from a timestamp of another system's, if it is later."""
        self._last = max(self._last, timestamp)


class Signer:
    """Signs what goes out on one link. The signers of all links share a clock."""

    def __init__(self, key: Key, link_id: int, clock: Clock) -> None:
        self._key = key
        self._link = bytes((link_id & 0xFF,))
        self._clock = clock

    def sign(self, packet: bytes) -> bytes:
        """A MAVLink 2 packet of ours with its signature; `frame` best sets the flag at once."""
        if not packet[_FLAGS] & SIGNED:
            packet = _with_flags(packet, SIGNED)
        data = packet + self._link + self._clock.next().to_bytes(6, "little")
        return data + self._key.signature(data)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Which of N packets may come in: `keep` (N,); of these `signed` (N,) carry a right signature.

    `refused` counts the others by their reasons.
    """

    keep: NDArray[np.bool_]
    signed: NDArray[np.bool_]
    refused: Counter[str]


class Verifier:
    """Judges what comes in, on all links together: a packet of one link is no news on another."""

    def __init__(self, key: Key, clock: Clock, streams: Mapping[Stream, int] | None = None) -> None:
        self._key = key
        self._clock = clock
        self._streams: dict[Stream, int] = dict(streams or {})

    @property
    def streams(self) -> Mapping[Stream, int]:
        """The last timestamp of each stream."""
        return self._streams

    def check(self, frames: Frames, unsigned: bool) -> Verdict:
        """Judge the packets of a datagram in their order; `unsigned` ones are taken or not."""
        keep, signed = np.ones(len(frames), np.bool_), np.zeros(len(frames), np.bool_)
        refused: Counter[str] = Counter()
        for i in range(len(frames)):
            packet = frames.packet(i)
            if is_signed(packet):
                reason = self._refusal(packet)
                signed[i] = reason is None
            elif unsigned or frames.msgid[i] == RADIO_STATUS:
                continue
            else:
                reason = "unsigned"
            if reason is not None:
                keep[i] = False
                refused[reason] += 1
        return Verdict(keep, signed, refused)

    def _refusal(self, packet: bytes) -> str | None:
        """Why a signed packet is refused, or None; only a right signature changes anything here."""
        data = packet[:-_SIGNATURE]
        if not hmac.compare_digest(self._key.signature(data), packet[-_SIGNATURE:]):
            return "wrong signature"
        timestamp = int.from_bytes(data[-6:], "little")
        if timestamp > LATEST:
            return "timestamp out of range"
        stream = (data[-7], packet[5], packet[6])
        last = self._streams.get(stream)
        if last is None:
            if timestamp + STALE < self._clock.now():
                return "new stream with an old timestamp"
            if len(self._streams) >= MAX_STREAMS:
                return "too many signed streams"
        elif timestamp <= last:
            return "timestamp seen before"
        self._streams[stream] = timestamp
        self._clock.see(timestamp)
        return None


def is_signed(packet: bytes) -> bool:
    """True for a packet that carries a signature, right or wrong."""
    return packet[0] == STX_V2 and bool(packet[_FLAGS] & SIGNED)


def unsigned(packet: bytes) -> bytes:
    """A packet of a known message as it would be without a signature: so it goes into recordings."""
    return _with_flags(packet, 0) if is_signed(packet) else packet


def without_secrets(frames: Frames) -> Frames:
    """All but SETUP_SIGNING, which carries a key: it is not taken, recorded or passed on, with or without a key."""
    secret = frames.msgid == SETUP_SIGNING
    return frames.select(~secret) if secret.any() else frames


def _with_flags(packet: bytes, flags: int) -> bytes:
    """A MAVLink 2 packet with other incompatibility flags, the checksum made anew, and no signature."""
    msgid = int.from_bytes(packet[7:10], "little")
    extra = int(WIRE[msgid]) & 0xFF
    data = packet[:_FLAGS] + bytes((flags,)) + packet[_FLAGS + 1 : _HEADER + packet[1]]
    crc = crc16.mcrf4xx(bytes((extra,)), crc16.mcrf4xx(data[1:]))
    return data + crc.to_bytes(2, "little")
