"""Bytes in, intact MAVLink packets out: a table of where each one lies and what was damaged between
them.

One kernel walks a buffer: a datagram, or a whole tlog. Packets of MAVLink 1 and 2 are found by
their start byte, length and checksum (CRC-16/MCRF4XX over header, payload and the message's
crc_extra); after damage the walk goes on byte by byte, so that an intact packet is never lost to a
broken neighbour. Every buffer is walked from a clean state, so a truncated datagram cannot spoil
the next one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavins.mavlink.codec.fields import WIRE
from mavins.nav.kernels import kernel
from mavins.types import IntArray

Buffer: TypeAlias = "bytes | bytearray | memoryview | NDArray[np.uint8]"

STX_V1: Final = 0xFE
STX_V2: Final = 0xFD
STAMP_LENGTH: Final = 8
"""Bytes of a tlog before each packet: the reception in microseconds, big-endian."""
_SIGNED: Final = 0x01
_SIGNATURE_LENGTH: Final = 13

_INTACT: Final = 0
_UNKNOWN: Final = 1
_DAMAGED: Final = 2
_TRUNCATED: Final = 3

START, END, PAYLOAD, LENGTH, MSGID, SYSID, COMPID, SEQ, T_US = range(9)


def _crc_table() -> NDArray[np.uint16]:
    table = np.empty(256, np.uint16)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
        table[byte] = crc
    return table


_CRC: Final = _crc_table()


@dataclass(frozen=True, slots=True)
class Damage:
    """What a buffer held besides intact packets.

    `bad_crc` and `truncated` count packets, `unknown` well-formed packets whose id the dialect
    lacks (their checksum cannot be told), `skipped_bytes` all bytes outside of intact and unknown
    packets.
    """

    bad_crc: int = 0
    unknown: int = 0
    skipped_bytes: int = 0
    truncated: int = 0

    def __bool__(self) -> bool:
        return bool(self.bad_crc or self.unknown or self.skipped_bytes or self.truncated)


_UNHURT: Final = Damage()


@dataclass(frozen=True, slots=True)
class Frames:
    """The N intact packets of a buffer, in order.

    `data` is the buffer; the columns of `table` (9, N) are named by the properties. Offsets count
    bytes of `data`; a packet is data[start:end], signature included; `t_us` is the reception stamp
    of a tlog, else 0.
    """

    data: NDArray[np.uint8]
    table: IntArray
    damage: Damage

    def __len__(self) -> int:
        return len(self.table[0])

    def _column(self, k: int) -> IntArray:
        column: IntArray = self.table[k]
        return column

    @property
    def start(self) -> IntArray:
        """Where each packet starts, (N,)."""
        return self._column(START)

    @property
    def end(self) -> IntArray:
        """Where each packet ends, (N,)."""
        return self._column(END)

    @property
    def payload(self) -> IntArray:
        """Where each payload starts, (N,)."""
        return self._column(PAYLOAD)

    @property
    def length(self) -> IntArray:
        """Payload bytes on the wire, (N,); MAVLink 2 cuts trailing zeros off."""
        return self._column(LENGTH)

    @property
    def msgid(self) -> IntArray:
        """Message ids, (N,)."""
        return self._column(MSGID)

    @property
    def sysid(self) -> IntArray:
        """System ids of the senders, (N,)."""
        return self._column(SYSID)

    @property
    def compid(self) -> IntArray:
        """Component ids of the senders, (N,)."""
        return self._column(COMPID)

    @property
    def seq(self) -> IntArray:
        """Sequence numbers, (N,)."""
        return self._column(SEQ)

    @property
    def t_us(self) -> IntArray:
        """Reception stamps in microseconds, (N,): of a tlog, or as given to `scan`."""
        return self._column(T_US)

    def packet(self, i: int) -> bytes:
        """The bytes of packet i, as they came."""
        return self.data[self.table[START, i] : self.table[END, i]].tobytes()

    def body(self, i: int, size: int) -> bytes:
        """The payload of packet i, cut or zero-padded to `size` bytes."""
        start = self.table[PAYLOAD, i]
        body = self.data[start : start + min(size, self.table[LENGTH, i])].tobytes()
        return body.ljust(size, b"\0")

    def select(self, chosen: NDArray[np.bool_] | IntArray) -> Frames:
        """The packets picked by a mask or by indices, in the same buffer."""
        return Frames(self.data, np.ascontiguousarray(self.table[:, chosen]), self.damage)


def scan(data: Buffer, received_us: int = 0) -> Frames:
    """All intact packets of one datagram (or any other run of packets), all received at once."""
    return _frames(data, 0, received_us)


def scan_tlog(data: Buffer) -> Frames:
    """All intact packets of a tlog, with the stamp in the 8 bytes before each one.

    A packet whose stamp is cut off by damage takes the stamp of the packet before.
    """
    return _frames(data, STAMP_LENGTH, 0)


def incomplete_at(data: Buffer) -> int:
    """Where in a piece of a stream the packet begins that is not whole yet; the piece's size where
    there is none.

    All before stays what it is, whatever comes next: `scan(data[:n])` finds the packets that it
    would find in the whole stream. What is kept is shorter than the longest packet.
    """
    return int(_incomplete_at(_readonly(data), WIRE))


def _readonly(data: Buffer) -> NDArray[np.uint8]:
    """The buffer as an array; a kernel is compiled anew for each kind of argument: all look
    read-only to it.
    """
    view = np.frombuffer(data, np.uint8)
    if not isinstance(data, bytes):
        view.flags.writeable = False
    return view


def _frames(data: Buffer, lead: int, received_us: int) -> Frames:
    view = _readonly(data)
    # room for the shortest packets; of a large table only the pages that are used take memory
    table = np.empty((9, view.size // (lead + 8) + 1), np.int64)
    count, bad_crc, unknown, skipped, truncated = _walk(view, lead, received_us, WIRE, table)
    damage = Damage(bad_crc, unknown, skipped, truncated) if unknown or skipped else _UNHURT
    return Frames(view, table[:, :count].copy(), damage)


@kernel
def _checksum(data: NDArray[np.uint8], start: int, end: int, extra: int) -> int:
    """CRC-16/MCRF4XX of data[start:end] and one extra byte."""
    crc = np.uint32(0xFFFF)
    for k in range(start, end):
        crc = (crc >> np.uint32(8)) ^ _CRC[(crc ^ data[k]) & np.uint32(0xFF)]
    crc = (crc >> np.uint32(8)) ^ _CRC[(crc ^ np.uint32(extra)) & np.uint32(0xFF)]
    return int(crc)


@kernel
def _stamp(data: NDArray[np.uint8], start: int) -> int:
    """The 8-byte big-endian stamp at `start`; the top bit is cleared so that it stays positive."""
    t = np.int64(data[start] & 0x7F)
    for k in range(start + 1, start + 8):
        t = t << 8 | np.int64(data[k])
    return int(t)


@kernel
def _header(data: NDArray[np.uint8], start: int, wire: IntArray, row: IntArray) -> int:
    """Read the packet that may begin at `start` into `row` (9,): one of the verdicts above."""
    size = data.size
    stx = data[start]
    header = 10 if stx == STX_V2 else 6
    if start + header > size:
        return _TRUNCATED
    length = np.int64(data[start + 1])
    at = start + (4 if stx == STX_V2 else 2)  # seq, sysid, compid, then the message id
    msgid = np.int64(data[at + 3])
    flags = np.int64(0)
    if stx == STX_V2:
        msgid |= np.int64(data[at + 4]) << 8 | np.int64(data[at + 5]) << 16
        flags = np.int64(data[start + 2])
    crc_at = start + header + length
    end = crc_at + 2 + (_SIGNATURE_LENGTH if flags & _SIGNED else 0)
    if end > size:
        return _TRUNCATED
    row[START] = start
    row[END] = end
    row[PAYLOAD] = start + header
    row[LENGTH] = length
    row[MSGID] = msgid
    row[SYSID] = data[at + 1]
    row[COMPID] = data[at + 2]
    row[SEQ] = data[at]
    if flags & ~_SIGNED != 0:
        return _DAMAGED
    known = wire[msgid] if msgid < wire.size else np.int64(-1)
    if known < 0:
        return _UNKNOWN
    if stx == STX_V1 and (length < (known >> 8 & 0xFF) or length > known >> 16):
        return _DAMAGED  # v1 neither cuts zeros off nor knows of longer versions
    crc = _checksum(data, start + 1, int(crc_at), int(known) & 0xFF)
    if data[crc_at] | np.int64(data[crc_at + 1]) << 8 != crc:
        return _DAMAGED
    return _INTACT


@kernel
def _hides_intact(
    data: NDArray[np.uint8], start: int, end: int, wire: IntArray, scratch: IntArray
) -> bool:
    """True where an intact packet begins inside data[start:end], which only looks like a packet."""
    for k in range(start + 1, end):
        if (data[k] == STX_V2 or data[k] == STX_V1) and _header(data, k, wire, scratch) == _INTACT:
            return True
    return False


@kernel
def _walk(
    data: NDArray[np.uint8], lead: int, received_us: int, wire: IntArray, table: IntArray
) -> tuple[int, int, int, int, int]:
    """Fill `table` (9, capacity); `lead` bytes go before each packet.

    Returns (packets, bad_crc, unknown, skipped_bytes, truncated).
    """
    size = data.size
    row = np.zeros(9, np.int64)
    scratch = np.zeros(9, np.int64)
    row[T_US] = received_us
    count = bad_crc = unknown = skipped = truncated = 0
    done = 0  # all before is accounted for
    start = expected = lead  # where a packet begins if nothing is damaged: a failure there counts
    stepped_over_stamp = lead > 0
    while start < size:
        verdict = _DAMAGED
        aligned = False
        if data[start] == STX_V2 or data[start] == STX_V1:
            verdict = _header(data, start, wire, row)
            follows = row[END] + lead
            if verdict != _TRUNCATED:
                aligned = row[END] == size or (
                    follows < size and (data[follows] == STX_V2 or data[follows] == STX_V1)
                )
            if verdict == _UNKNOWN and aligned:
                # the rest of a truncated packet and the next one together may look like that
                aligned = not _hides_intact(data, start, int(row[END]), wire, scratch)
            truncated += verdict == _TRUNCATED and start == expected
            bad_crc += verdict == _DAMAGED and (start == expected or aligned)
        if verdict == _INTACT or (verdict == _UNKNOWN and aligned):
            # a stamp that would overlap the packet before was cut off: the stamp before stays
            if start - lead >= done and lead > 0:
                row[T_US] = _stamp(data, start - lead)
            skipped += max(0, start - lead - done)
            if verdict == _UNKNOWN:
                unknown += 1
            else:
                for k in range(9):
                    table[k, count] = row[k]
                count += 1
            done = row[END]
            start = expected = done + lead
            stepped_over_stamp = lead > 0
            continue
        if start == expected:
            expected = -1
        if aligned:
            expected = max(expected, follows)
        if stepped_over_stamp:  # the next packet may have lost part of its stamp
            start = done
            stepped_over_stamp = False
        else:
            start += 1
    return count, bad_crc, unknown, skipped + size - done, truncated


@kernel
def _may_become(data: NDArray[np.uint8], start: int, wire: IntArray, is_expected: bool) -> bool:
    """True where the cut packet at `start` may be intact once it is whole, or, where a packet is
    expected, one that the dialect lacks.
    """
    left = data.size - start
    if data[start] == STX_V2:
        if left > 2 and np.int64(data[start + 2]) & ~_SIGNED != 0:
            return False
        if left < 10:
            return True
        msgid = np.int64(data[start + 7]) | np.int64(data[start + 8]) << 8
        msgid |= np.int64(data[start + 9]) << 16
        return bool(is_expected or (msgid < wire.size and wire[msgid] >= 0))
    if left < 6:
        return True
    known = wire[np.int64(data[start + 5])]
    if known < 0:
        return is_expected
    length = np.int64(data[start + 1])
    return bool(length >= (known >> 8 & 0xFF) and length <= known >> 16)


@kernel
def _incomplete_at(data: NDArray[np.uint8], wire: IntArray) -> int:
    """Walk from intact packet to intact packet, else byte by byte, as `_walk` does, up to the first
    that may still become one.
    """
    row = np.zeros(9, np.int64)
    start = expected = 0
    while start < data.size:
        if data[start] == STX_V2 or data[start] == STX_V1:
            verdict = _header(data, start, wire, row)
            if verdict == _TRUNCATED and _may_become(data, start, wire, start == expected):
                return start
            if verdict == _INTACT:
                start = expected = row[END]
                continue
            if verdict == _UNKNOWN and start == expected:
                expected = row[END]
        start += 1
    return start


@kernel
def gather(
    data: NDArray[np.uint8], payload: IntArray, length: IntArray, size: int
) -> NDArray[np.uint8]:
    """The payloads at `payload` (N,), each cut or zero-padded to `size` bytes: (N, size)."""
    rows = np.zeros((payload.size, size), np.uint8)
    for i in range(payload.size):
        for k in range(min(size, length[i])):
            rows[i, k] = data[payload[i] + k]
    return rows
