"""Dataflash logs as text: a line per message, its name first, numbers in the units of the fields' descriptions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO, Final

import numpy as np

from mavins.logs.dataflash.formats import (
    TEXTS,
    Batch,
    Column,
    Format,
    Wanted,
    format_of,
    microseconds,
)
from mavins.logs.dataflash.survey import Survey
from mavins.types import FloatArray

_CHUNK: Final = 1 << 22
_LONGEST: Final = 1 << 14
"""Bytes of a line; more is damage."""


class TextLog:
    """The messages of a log as text, once, in batches; `skipped` bytes that belong to none are counted on the way."""

    def __init__(self, stream: IO[bytes], wanted: Wanted) -> None:
        self._stream = stream
        self._wanted = wanted
        self._formats: dict[bytes, Format] = {}
        self._taken: dict[bytes, tuple[str, ...]] = {}
        self.skipped = 0
        self.survey = Survey()

    def __iter__(self) -> Iterator[Batch]:
        rest, final = b"", False
        while not final:
            part = self._stream.read(_CHUNK)
            final = not part
            lines = (rest + part).split(b"\n")
            rest = b"" if final else lines.pop()
            if len(rest) > _LONGEST:
                self.skipped += len(rest)
                rest = b""
            yield from self._batches(lines)

    def _batches(self, lines: list[bytes]) -> Iterator[Batch]:
        found: dict[bytes, list[bytes]] = {}
        for line in lines:
            name = line[: line.find(b",")].strip()
            if name == b"FMT":
                self._define(line)
            elif name in self._formats:
                found.setdefault(name, []).append(line)
            else:
                self.skipped += len(line)
        for name, mine in found.items():
            form = self._formats[name]
            if name in self._taken:
                batch, good = _batch(form, self._taken[name], mine)
                self.skipped += sum(map(len, mine)) - sum(map(len, good))
                self.survey.add(form.name, batch.count, batch.t_us)
                yield batch
            else:
                ends, _ = _batch(form, (), [mine[0], mine[-1]])
                self.survey.add(form.name, len(mine), ends.t_us)

    def _define(self, line: bytes) -> None:
        """Take a format: FMT, type, length, name, characters, labels."""
        parts = [part.strip() for part in line.decode("latin-1").split(",", 5)]
        form = format_of(*parts[3:]) if len(parts) == 6 else None
        if form is None:
            self.skipped += len(line)
            return
        name = form.name.encode("latin-1")
        if self._formats.setdefault(name, form) is form:
            labels = self._wanted(form)
            if labels:
                self._taken[name] = labels


def _batch(form: Format, labels: tuple[str, ...], lines: list[bytes]) -> tuple[Batch, list[bytes]]:
    """Some lines of one message, and those of them that are not damaged."""
    n, stamp = len(form.labels), form.stamp
    # only a last text may hold commas
    open_end = form.characters[-1] in TEXTS
    whole = [line for line in lines if (k := line.count(b",")) == n or (open_end and k > n)]
    texts = [label for label in labels if form.character(label) in TEXTS]
    numbers = [label for label in labels if label not in texts]
    stamps = [] if stamp is None else [stamp]
    at = [form.labels.index(label) + 1 for label in (*stamps, *numbers)]
    table, good = _numbers(whole, at)
    t_us = np.empty(0, np.int64) if stamp is None else microseconds(stamp, table[:, 0])
    columns: dict[str, Column] = {
        label: table[:, k].copy() for k, label in enumerate(numbers, len(stamps))
    }
    for label in texts:
        k = form.labels.index(label) + 1
        fields = [line.split(b",", n)[k].strip() for line in good]
        columns[label] = np.array(fields, np.bytes_)
    return Batch(form, t_us, columns, len(good)), good


def _numbers(lines: list[bytes], at: list[int]) -> tuple[FloatArray, list[bytes]]:
    """The columns `at` of those lines in which they are numbers, (N, len(at)), and the lines."""
    if not lines or not at:
        return np.empty((len(lines), len(at))), lines
    try:
        table = np.loadtxt(lines, delimiter=",", comments=None, usecols=at, ndmin=2)
        return table, lines
    except ValueError:
        pass
    rows, good = [], []
    for line in lines:
        fields = line.split(b",")
        try:
            rows.append([float(fields[k]) for k in at])
        except ValueError:
            continue
        good.append(line)
    return np.array(rows).reshape(-1, len(at)), good
