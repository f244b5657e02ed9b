"""Binary dataflash logs as a stream: whole messages are found in a buffer by a kernel, and taken as tables.

There are no checksums. A message is believed where the next one begins right behind it; after damage the walk goes on
byte by byte until that holds again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from mavins.logs.dataflash.formats import (
    CHARACTERS,
    FMT,
    FMT_LENGTH,
    HEADER,
    TEXTS,
    Batch,
    Column,
    Format,
    Wanted,
    format_of,
    microseconds,
)
from mavins.logs.dataflash.survey import Survey
from mavins.nav.kernels import kernel
from mavins.types import IntArray

Bytes = NDArray[np.uint8]

_CHUNK: Final = 1 << 22
_SHORTEST: Final = 4
"""Bytes of the shortest message: a header and one field."""
_FIELDS: Final = 16
"""Characters in a FMT; they follow type, length and name."""


@kernel
def _length(data: Bytes, pos: int, lengths: IntArray) -> int:
    """The length of the message whose header may be at `pos`; 0 where there is none."""
    if pos + 3 > len(data) or data[pos] != 0xA3 or data[pos + 1] != 0x95:
        return 0
    return int(lengths[data[pos + 2]])


@kernel
def _define(data: Bytes, pos: int, lengths: IntArray, sizes: IntArray) -> None:
    """Take the length of a type from the FMT at `pos`, if it is new and agrees with its fields."""
    size = 3
    for i in range(pos + 9, pos + 25):
        if data[i] == 0:
            break
        if sizes[data[i]] == 0:
            return
        size += sizes[data[i]]
    if size >= 4 and size == data[pos + 4] and lengths[data[pos + 3]] == 0:
        lengths[data[pos + 3]] = size


@kernel
def _headers(data: Bytes, pos: int, end: int, lengths: IntArray) -> int:
    """How many headers there are between `pos` and `end`."""
    count = 0
    for k in range(pos, end):
        count += _length(data, k, lengths) > 0
    return count


@kernel
def find_messages(
    data: Bytes,
    final: bool,
    state: IntArray,
    lengths: IntArray,
    sizes: IntArray,
    start: IntArray,
    kind: Bytes,
) -> int:
    """Where messages start in `data` (N,), and their types; returns their number.

    `state` is (bytes walked, bytes skipped, whether the last message had a successor): the second is raised. The rest
    of the buffer is kept for the next walk, unless this is the final one. `lengths` (256,) of the types is filled from
    FMT, `sizes` (256,) are those of the characters of fields.
    """
    n = len(data)
    pos = 0
    count = 0
    while pos < n:
        length = _length(data, pos, lengths)
        end = pos + length
        if not final and (n - pos < 3 or end + 2 > n):
            break
        followed = False
        whole = False
        if length > 0 and end <= n:
            followed = end == n or (end + 2 <= n and data[end] == 0xA3 and data[end + 1] == 0x95)
            whole = followed or (state[2] == 1 and _headers(data, pos + 3, end, lengths) == 0)
        state[2] = 1 if followed else 0
        if whole:
            start[count] = pos
            kind[count] = data[pos + 2]
            if kind[count] == 128:
                _define(data, pos, lengths, sizes)
            count += 1
            pos = end
        else:
            state[1] += 1
            pos += 1
    state[0] = pos
    return count


class BinaryLog:
    """The messages of a binary log, once, in batches; `skipped` bytes that belong to none are counted on the way."""

    def __init__(self, stream: IO[bytes], wanted: Wanted) -> None:
        self._stream = stream
        self._wanted = wanted
        self._formats: dict[int, Format] = {}
        self._rows: dict[int, np.dtype[np.void]] = {}
        self._taken: dict[int, tuple[str, ...]] = {}
        self._lengths = np.zeros(256, np.int64)
        self._lengths[FMT] = FMT_LENGTH
        self._sizes = np.zeros(256, np.int64)
        for character, (field, _) in CHARACTERS.items():
            self._sizes[ord(character)] = np.dtype(field).itemsize
        self._state = np.array([0, 0, 1])
        self.survey = Survey()

    @property
    def skipped(self) -> int:
        """Bytes so far that belong to no message."""
        return int(self._state[1])

    def __iter__(self) -> Iterator[Batch]:
        buffer: Bytes = np.empty(_CHUNK + 1024, np.uint8)
        start: IntArray = np.empty(len(buffer) // _SHORTEST + 1, np.int64)
        kind: Bytes = np.empty(len(start), np.uint8)
        have, final = 0, False
        while not final:
            part = self._stream.read(_CHUNK)
            final = not part
            buffer[have : have + len(part)] = np.frombuffer(part, np.uint8)
            have += len(part)
            count = find_messages(
                buffer[:have], final, self._state, self._lengths, self._sizes, start, kind
            )
            yield from self._batches(buffer[:have], start[:count], kind[:count])
            walked = int(self._state[0])
            buffer[: have - walked] = buffer[walked:have].copy()
            have -= walked

    def _batches(self, data: Bytes, start: IntArray, kind: Bytes) -> Iterator[Batch]:
        present = np.flatnonzero(np.bincount(kind, minlength=256)).tolist()
        if FMT in present:
            self._define(self._messages(data, start[kind == FMT], FMT))
        for number in present:
            form = self._formats.get(number)
            if form is None:
                continue
            mine = start[kind == number]
            rows = self._messages(data, mine if number in self._taken else mine[[0, -1]], number)
            batch = _batch(form, self._taken.get(number, ()), rows.view(self._rows[number])[:, 0])
            self.survey.add(form.name, len(mine), batch.t_us)
            if number in self._taken:
                yield batch

    def _messages(self, data: Bytes, start: IntArray, number: int) -> Bytes:
        """Messages (N, length) of one type."""
        windows = np.lib.stride_tricks.sliding_window_view(data, int(self._lengths[number]))
        return windows[start]

    def _define(self, rows: Bytes) -> None:
        """Take formats from FMT messages, the first of each type that can be."""
        for row in rows:
            number, length = int(row[HEADER]), int(row[HEADER + 1])
            text = row[HEADER + 2 :].tobytes().decode("latin-1")
            name, characters, labels = (
                part.partition("\0")[0]
                for part in (text[:4], text[4 : 4 + _FIELDS], text[4 + _FIELDS :])
            )
            form = format_of(name, characters, labels)
            if form is None or number in self._formats or number == FMT:
                continue
            row = form.row
            if row.itemsize == length == self._lengths[number]:
                self._formats[number], self._rows[number] = form, row
                wanted = self._wanted(form)
                if wanted:
                    self._taken[number] = wanted


def _batch(form: Format, labels: tuple[str, ...], rows: NDArray[np.void]) -> Batch:
    stamp = form.stamp
    t_us = np.empty(0, np.int64) if stamp is None else microseconds(stamp, rows[stamp])
    columns: dict[str, Column] = {}
    for label in labels:
        if form.character(label) in TEXTS:
            columns[label] = rows[label].copy()
        else:
            columns[label] = rows[label] * np.float64(CHARACTERS[form.character(label)][1])
    return Batch(form, t_us, columns, len(rows))
