"""Which messages of a dataflash log are read, what for, and which of several receivers or cores.

A source is named by its message and its number in the log: IMU[0], GPS[1], XKF1[0]. Older logs have a message for each
(IMU2, GPS2, NKF6), which gets the same name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import DTypeLike

from mavins.errors import LogFormatError
from mavins.logs.dataflash.formats import NO_NUMBERS, Batch, Format
from mavins.logs.dataflash.tables import Table
from mavins.types import FloatArray, IntArray

_INSTANCES: Final = ("I", "C", "Inst", "Instance", "IMU", "Type")
"""How the field that numbers sensors, cores or origins is called; it is the second one."""
_WHOLE: Final = "bBhHiI"
_OLDER: Final = {
    "IMU2": ("IMU", 1),
    "IMU3": ("IMU", 2),
    "IMT2": ("IMT", 1),
    "IMT3": ("IMT", 2),
    "GPS2": ("GPS", 1),
    "GPA2": ("GPA", 1),
    "MAG2": ("MAG", 1),
    "MAG3": ("MAG", 2),
    "BAR2": ("BARO", 1),
    "BAR3": ("BARO", 2),
    "NKF6": ("NKF1", 1),
    "XKF6": ("XKF1", 1),
}


@dataclass(frozen=True, slots=True, order=True)
class Name:
    """A source: a message, and which of several."""

    message: str
    number: int = 0

    def __str__(self) -> str:
        return f"{self.message}[{self.number}]"


@dataclass(frozen=True, slots=True)
class Wish:
    """A source that is asked for: by its number, its message, or both."""

    text: str
    message: str | None
    number: int | None

    def allows(self, name: Name) -> bool:
        """Whether a source is one of those."""
        return self.message in (None, name.message) and self.number in (None, name.number)


def wish_of(text: str | None) -> Wish | None:
    """What `1`, `GPS` or `GPS[1]` ask for."""
    if text is None:
        return None
    if text.isdecimal():
        return Wish(text, None, int(text))
    if text in _OLDER:
        return Wish(text, *_OLDER[text])
    message, _, number = text.removesuffix("]").partition("[")
    return Wish(text, message, int(number) if number.isdecimal() else None)


def instance_label(form: Format) -> str | None:
    """The field that numbers the sensors or cores that send a message."""
    label = form.labels[1] if len(form.labels) > 1 else ""
    return label if label in _INSTANCES and form.character(label) in _WHOLE else None


def parts(batch: Batch) -> Iterator[tuple[Name, IntArray]]:
    """The sources in a batch in the order of their numbers, and which rows are theirs."""
    message, number = _OLDER.get(batch.format.name, (batch.format.name, 0))
    label = instance_label(batch.format)
    if label is None or label not in batch.columns:
        yield Name(message, number), np.arange(batch.count)
        return
    numbers = batch.columns[label]
    for found in np.unique(numbers[np.isfinite(numbers)]).tolist():
        yield Name(message, int(found)), np.flatnonzero(numbers == found)


@dataclass(frozen=True, slots=True)
class Reading:
    """How a message is read: its fields, those in brackets may be lacking, and what its rows (M, fields) become.

    What is not lacking must be finite, before and after; else there is no reading. `over` is the field, counted from 0,
    that says over how many s before its stamp a reading is a mean: it is put in the middle of that.
    """

    labels: tuple[str, ...]
    convert: Callable[[FloatArray], FloatArray] = lambda rows: rows
    over: int | None = None

    @property
    def plain(self) -> tuple[str, ...]:
        """The fields without brackets."""
        return tuple(label.strip("[]") for label in self.labels)

    @property
    def needed(self) -> tuple[str, ...]:
        """The fields that may not be lacking; they come first."""
        return tuple(label for label in self.labels if not label.startswith("["))

    def rows(self, batch: Batch, chosen: IntArray) -> tuple[IntArray, FloatArray]:
        """The readings in the `chosen` rows of a batch, and when they were taken."""
        raw = np.full((len(chosen), len(self.labels)), np.nan)
        for k, label in enumerate(self.plain):
            if label in batch.columns:
                raw[:, k] = batch.columns[label][chosen]
        n = len(self.needed)
        with np.errstate(all="ignore"):
            rows = self.convert(raw)
        usable = np.isfinite(raw[:, :n]).all(axis=1) & np.isfinite(rows[:, :n]).all(axis=1)
        t_us = batch.t_us[chosen[usable]]
        if self.over is not None:
            t_us = t_us - np.rint(raw[usable, self.over] * 5e5).astype(np.int64)
        return t_us, rows[usable]


@dataclass(slots=True)
class Channel:
    """Rows of one quantity, from the best of the sources that may give it.

    `messages` are those that do, the best first. Of one message the first source that speaks is taken, unless there is
    a `wish`. `dropped` counts rows that hold no reading.
    """

    messages: dict[str, Reading]
    wish: Wish | None = None
    dtype: DTypeLike = np.float64
    period_us: int = 0
    source: Name | None = None
    seen: set[Name] = field(default_factory=set)
    table: Table = field(default_factory=Table)
    unusable: int = 0

    def __len__(self) -> int:
        return len(self.table)

    @property
    def dropped(self) -> dict[str, int]:
        """How many rows hold no reading, by reason."""
        return {
            f"{self.source} not a reading": self.unusable,
            f"{self.source} stamp not in order": self.table.dropped,
        }

    def fields_of(self, form: Format) -> tuple[str, ...]:
        """The fields of a message that this reads; none where it cannot be used."""
        reading = self.messages.get(_OLDER.get(form.name, (form.name, 0))[0])
        if reading is None or form.stamp is None or not all(map(form.has, reading.needed)):
            return ()
        number = instance_label(form)
        labels = [*filter(form.has, reading.plain), *([number] if number else [])]
        return () if any(form.character(label) in NO_NUMBERS for label in labels) else tuple(labels)

    def take(self, batch: Batch) -> None:
        """Keep what a batch has of the source that is read."""
        for name, chosen in parts(batch):
            if name.message not in self.messages:
                return
            self.seen.add(name)
            if self.wish is not None and not self.wish.allows(name):
                continue
            if self.source is None or self._rank(name) < self._rank(self.source):
                self.source = name
                self.table = Table(self.dtype, self.period_us)
                self.unusable = 0
            if name == self.source:
                t_us, rows = self.messages[name.message].rows(batch, chosen)
                self.unusable += len(chosen) - len(rows)
                self.table.append(t_us, rows)

    def _rank(self, name: Name) -> int:
        return list(self.messages).index(name.message)

    @property
    def choices(self) -> list[str]:
        """The sources that could be chosen."""
        return [str(name) for name in sorted(self.seen, key=lambda n: (self._rank(n), n.number))]

    def check(self, what: str) -> None:
        """LogFormatError where a source was asked for that the log does not have."""
        if self.wish is not None and not len(self.table):
            have = ", ".join(self.choices) or "none"
            raise LogFormatError(
                f"the log has no {what} called {self.wish.text[:40]!r}; it has {have}"
            )
