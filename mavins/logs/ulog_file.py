"""PX4's ULog format: a file in one pass and in pieces, so that of any size only what is wanted is held.

After a header of 16 bytes come messages: 2 bytes of length, a type, and so many bytes. They have no checksum, so damage
shows in what cannot follow. Data are taken in a length that their format allows, any other message where its type is
known and the next begins where it ends; bytes between such are counted as skipped.
Format: docs.px4.io, "ULog File Format".
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavins.errors import LogFormatError
from mavins.nav.kernels import kernel
from mavins.types import IntArray

Bytes: TypeAlias = NDArray[np.uint8]
Rows: TypeAlias = NDArray[Any]
Topic: TypeAlias = tuple[str, int]
"""The name of a topic and the number of its instance."""

MAGIC: Final = b"ULog\x01\x12\x35"
_HEADER: Final = 16
_PIECE: Final = 1 << 22
_FRAME: Final = 3
_FIELDS: Final = 5
"""Bytes of a message of data before its fields."""
_IDS: Final = 1 << 16
_DATA: Final = ord("D")
_KNOWN: Final = np.isin(np.arange(256), list(b"ABCDFILMOPQRS"))
_SCALARS: Final = {
    "int8_t": "i1",
    "uint8_t": "u1",
    "bool": "u1",
    "char": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
}


@dataclass(slots=True)
class UlogFile:
    """What a file holds: `topics` -> rows of the wanted fields, in the file's order.

    `counts` tells how many messages there are of every topic and `spans` the stamps of the first and the last of them
    in us; `dropouts` and `dropout_ms` are what the vehicle's own logger could not keep up with. `size` is the file's
    when unpacked, of which `skipped` bytes are damaged.
    """

    start_us: int
    topics: dict[Topic, Rows] = field(default_factory=dict)
    counts: Counter[Topic] = field(default_factory=Counter)
    spans: dict[Topic, tuple[int, int]] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    info: dict[str, str] = field(default_factory=dict)
    size: int = 0
    skipped: int = 0
    dropouts: int = 0
    dropout_ms: int = 0


def scan(stream: IO[bytes], wanted: Mapping[str, tuple[str, ...]]) -> UlogFile:
    """Read a file, and of the topics `wanted` the named fields as far as they have them.

    LogFormatError for what is not a ULog, or of a kind that says that it cannot be read like this.
    """
    head = stream.read(_HEADER)
    if len(head) < _HEADER or not head.startswith(MAGIC):
        raise LogFormatError("not a PX4 .ulg")
    scanner = _Scanner(int.from_bytes(head[8:], "little"), wanted)
    scanner.read(stream)
    return scanner.result()


@kernel
def _begins(data: Bytes, at: int, end: int, known: NDArray[np.bool_]) -> bool:
    """True where a message may begin, as far as the bytes before `end` tell."""
    return at + 3 > end or (known[data[at + 2]] and (data[at] != 0 or data[at + 1] != 0))


@kernel
def walk(
    data: Bytes,
    end: int,
    closed: bool,
    known: NDArray[np.bool_],
    least: IntArray,
    most: IntArray,
    found: IntArray,
    state: IntArray,
) -> bool:
    """Through data[:end] up to a message that is not data (True), or to where it takes more bytes to go on (False).

    `least`, `most` (65536,) are the lengths that each id's data may have; where data begin is written into `found`.
    `state` is taken up and left: where the walk is, how many were found, bytes skipped. With `closed` there are no
    more bytes: a message that goes beyond the end is none.
    """
    at, n, skipped = state[0], state[1], state[2]
    other = False
    while at + 3 <= end:
        size = np.int64(data[at]) + 256 * np.int64(data[at + 1])
        after = at + 3 + size
        sound = False
        if data[at + 2] == _DATA:
            if at + 5 <= end:
                topic = np.int64(data[at + 3]) + 256 * np.int64(data[at + 4])
                sound = least[topic] <= size <= most[topic]
            elif not closed:
                break
        elif _begins(data, at, end, known):
            sound = _begins(data, after, end, known)
        if sound and after > end:
            if not closed:
                break
            sound = False
        if not sound:
            at += 1
            skipped += 1
        elif data[at + 2] == _DATA:
            found[n] = at
            n += 1
            at = after
        else:
            other = True
            break
    state[0], state[1], state[2] = at, n, skipped
    return other


@kernel
def gathered(data: Bytes, starts: IntArray, size: int) -> Bytes:
    """The `size` bytes from each of `starts` (N,) on, as rows (N, size)."""
    out = np.empty((len(starts), size), dtype=np.uint8)
    for k in range(len(starts)):
        for i in range(size):
            out[k, i] = data[starts[k] + i]
    return out


class _Subscription:
    """One topic's data: where its fields lie, and what was kept of them so far."""

    def __init__(self, topic: Topic, size: int, places: list[tuple[str, Any, int]]) -> None:
        self.topic = topic
        self.parts: list[Rows] = []
        names, formats, offsets = (list(column) for column in zip(*places, strict=True))
        self._size = size
        self._there = np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
        )
        self._kept = np.dtype(list(zip(names, formats, strict=True)))

    def take(self, data: Bytes, starts: IntArray) -> None:
        """Keep the wanted fields of the data that begin at `starts`."""
        rows = gathered(data, starts + _FIELDS, self._size).view(self._there)[:, 0]
        part = np.empty(len(rows), self._kept)
        for name in self._kept.names or ():
            part[name] = rows[name]
        self.parts.append(part)

    def rows(self) -> Rows:
        """All that was kept."""
        return np.concatenate(self.parts) if self.parts else np.empty(0, self._kept)


class _Scanner:
    """The pass through a file: formats, subscriptions and data as they come."""

    def __init__(self, start_us: int, wanted: Mapping[str, tuple[str, ...]]) -> None:
        self._found = UlogFile(start_us)
        self._wanted = wanted
        self._formats: dict[str, list[tuple[str, int, str]]] = {}
        self._names: dict[int, tuple[Topic, int]] = {}
        self._kept: dict[int, _Subscription] = {}
        self._all: list[_Subscription] = []
        self._least = np.zeros(_IDS, dtype=np.int64)
        self._most = np.full(_IDS, -1, dtype=np.int64)
        self._appended: list[int] = []
        self._at = np.empty(0, dtype=np.int64)

    def read(self, stream: IO[bytes]) -> None:
        """All of a file after its header."""
        rest, offset, closed = b"", _HEADER, False
        while not closed:
            piece = stream.read(_PIECE)
            closed = len(piece) < _PIECE
            data = np.frombuffer(rest + piece, dtype=np.uint8)
            at = self._through(data, offset, closed)
            rest, offset = data[at:].tobytes(), offset + at
        self._found.size = offset + len(rest)

    def result(self) -> UlogFile:
        """What was found."""
        found = self._found
        for kept in self._all:
            rows = kept.rows()
            kept.parts.clear()
            if len(rows):
                before = found.topics.get(kept.topic)
                found.topics[kept.topic] = rows if before is None else np.append(before, rows)
        return found

    def _through(self, data: Bytes, offset: int, closed: bool) -> int:
        """Through a piece that begins at `offset` in the file; returns where a message is not whole."""
        state = np.zeros(3, dtype=np.int64)
        if len(self._at) < len(data) // _FIELDS + 1:
            self._at = np.empty(len(data) // _FIELDS + 1, dtype=np.int64)
        while True:
            at = int(state[0])
            bounds = [edge - offset for edge in self._appended if at < edge - offset < len(data)]
            end = min([*bounds, len(data)])
            ends = closed or bool(bounds)
            if walk(data, end, ends, _KNOWN, self._least, self._most, self._at, state):
                self._flush(data, state)
                at = int(state[0])
                size = int(data[at]) + 256 * int(data[at + 1])
                payload = data[at + _FRAME : at + _FRAME + size].tobytes()
                try:
                    self._other(chr(data[at + 2]), payload)
                except (ArithmeticError, LookupError, RecursionError, ValueError, struct.error):
                    self._found.skipped += _FRAME + size
                state[0] = at + _FRAME + size
            elif ends and state[0] < len(data):
                state[2] += end - state[0]  # a message that was cut off here
                state[0] = end
            else:
                break
        self._flush(data, state)
        self._found.skipped += int(state[2])
        return int(state[0])

    def _flush(self, data: Bytes, state: IntArray) -> None:
        """Sort what the walk found by topics."""
        starts = self._at[: state[1]]
        state[1] = 0
        if not len(starts):
            return
        ids = data[starts + 3].astype(np.int64) + 256 * data[starts + 4].astype(np.int64)
        order = np.argsort(ids, kind="stable")
        edges = np.flatnonzero(np.diff(ids[order], prepend=-1, append=_IDS))
        for first, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            mine = starts[order[first:end]]
            number = int(ids[order[first]])
            topic, stamp = self._names[number]
            found = self._found
            found.counts[topic] += len(mine)
            begin, last = (
                int.from_bytes(data[k + stamp : k + stamp + 8].tobytes(), "little")
                for k in (int(mine[0]), int(mine[-1]))
            )
            found.spans[topic] = (found.spans.get(topic, (begin, 0))[0], last)
            if number in self._kept:
                self._kept[number].take(data, mine)

    def _other(self, kind: str, payload: bytes) -> None:
        """A message that is not data."""
        if kind == "F":
            name, _, fields = payload.decode("ascii").partition(":")
            self._formats[name] = [_field(text) for text in fields.split(";") if text]
        elif kind == "A":
            self._subscribe(payload[0], payload[1] + 256 * payload[2], payload[3:].decode("ascii"))
        elif kind == "B":
            self._flags(payload)
        elif kind in "PI":
            self._value(kind, payload)
        elif kind == "O":
            self._found.dropouts += 1
            self._found.dropout_ms += int.from_bytes(payload[:2], "little")

    def _flags(self, payload: bytes) -> None:
        unreadable = bytes([payload[8] & 0xFE]) + payload[9:16]
        if any(unreadable):
            raise LogFormatError(
                f"a .ulg of a kind that is not known here: flags {unreadable.hex()}"
            )
        if payload[8] & 1:
            self._appended = [edge for edge in struct.unpack("<3Q", payload[16:40]) if edge]

    def _value(self, message: str, payload: bytes) -> None:
        """A parameter or a piece of information: the first of a name stands."""
        kind, _, name = payload[1 : 1 + payload[0]].decode("ascii").partition(" ")
        value = payload[1 + payload[0] :]
        if message == "P":
            self._found.parameters.setdefault(name, float(np.frombuffer(value, _SCALARS[kind])[0]))
        elif kind.startswith("char"):
            self._found.info.setdefault(name, value.decode("utf-8", "replace"))

    def _subscribe(self, instance: int, number: int, name: str) -> None:
        """From here on data of this number are a topic's."""
        size, padded, stamp, places = 0, 0, 0, []
        for kind, count, label in self._formats[name]:
            if label == "timestamp":
                stamp = _FIELDS + padded
            if label in self._wanted.get(name, ()) and kind in _SCALARS:
                shape = (count,) if count else ()
                places.append((label, np.dtype((_SCALARS[kind], shape)), padded))
            padded += self._size_of(kind) * max(count, 1)
            if not label.startswith("_padding"):
                size = padded  # the last padding is not written
        if not stamp:
            raise ValueError(f"{name} has no stamps")
        topic = (name, instance)
        self._names[number] = (topic, stamp)
        self._least[number], self._most[number] = size + 2, padded + 2
        self._kept.pop(number, None)
        if places:
            self._kept[number] = _Subscription(topic, size, places)
            self._all.append(self._kept[number])

    def _size_of(self, kind: str) -> int:
        if kind in _SCALARS:
            return np.dtype(_SCALARS[kind]).itemsize
        return sum(self._size_of(k) * max(n, 1) for k, n, _ in self._formats[kind])


def _field(text: str) -> tuple[str, int, str]:
    """`float[3] gyro_rad` -> ("float", 3, "gyro_rad"); a count of 0 for what is no array."""
    kind, label = text.split(" ")
    kind, _, count = kind.partition("[")
    number = int(count.rstrip("]") or 0)
    if number < 0:
        raise ValueError(f"an array of {number} values")
    return kind, number, label
