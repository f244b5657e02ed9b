"""What an ArduPilot dataflash log says about its own messages: FMT, and the characters that stand for types.

The log describes itself: a FMT message gives each type of message a number, a length, a name, a character per field
and the fields' names. Theirs are the words: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavins.types import FloatArray, IntArray

HEADER: Final = 3
"""Bytes before the fields of a binary message: a3, 95 and the number of its type."""
FMT: Final = 128
"""The number of FMT itself."""
FMT_LENGTH: Final = 89

CHARACTERS: Final[dict[str, tuple[str, float]]] = {
    "a": ("(32,)<i2", 1.0),
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "g": ("<f2", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
    "M": ("u1", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}
"""Character of a field -> its type in a binary log, and what its number is multiplied by; text has it multiplied."""
TEXTS: Final = "nNZ"
NO_NUMBERS: Final = "a" + TEXTS
STAMPS: Final = {"TimeUS": 1, "TimeMS": 1000}
"""Fields that are stamps, and how many microseconds they count."""
_STAMP_LIMIT: Final = 2**50

Column: TypeAlias = "FloatArray | NDArray[np.bytes_]"


@dataclass(frozen=True, slots=True)
class Format:
    """A type of message: its name, and of each field a character and a label."""

    name: str
    characters: str
    labels: tuple[str, ...]

    @property
    def row(self) -> np.dtype[np.void]:
        """A binary message, header included."""
        types = [(label, CHARACTERS[c][0]) for label, c in self._fields()]
        return np.dtype([("", f"V{HEADER}"), *types])

    def has(self, label: str) -> bool:
        """Whether there is a field of this label."""
        return label in self.labels

    @property
    def stamp(self) -> str | None:
        """The field that is the stamp."""
        found = (label for label in STAMPS if label in self.labels)
        return next((label for label in found if self.character(label) not in NO_NUMBERS), None)

    def character(self, label: str) -> str:
        """The character of a field."""
        return self.characters[self.labels.index(label)]

    def _fields(self) -> list[tuple[str, str]]:
        return list(zip(self.labels, self.characters, strict=True))


def format_of(name: str, characters: str, labels: str) -> Format | None:
    """The format that a FMT message gives; None for one that is damaged."""
    words = tuple(label.strip() for label in labels.split(","))
    if (
        not name.isalnum()
        or len(words) != len(characters)
        or len(set(words)) != len(words)
        or not all(words)
        or not set(characters) <= set(CHARACTERS)
    ):
        return None
    return Format(name, characters, words)


def microseconds(label: str, values: NDArray[Any]) -> IntArray:
    """Stamps (N,) of a field as int64, negative where they cannot be."""
    possible = (values >= 0) & (values < _STAMP_LIMIT)
    stamps = np.where(possible, values, 0).astype(np.int64) * STAMPS[label]
    return np.where(possible, stamps, -1)


@dataclass(frozen=True, slots=True)
class Batch:
    """Some consecutive messages of one type: columns (N,) by label, as many as were asked for and are there.

    Numbers are float64 in the unit of the field's description; `t_us` (N,) are the stamps, none where there is no such
    field.
    """

    format: Format
    t_us: IntArray
    columns: Mapping[str, Column]
    count: int


Wanted: TypeAlias = Callable[[Format], tuple[str, ...]]
"""Which fields of a type of message are asked for; none: it is skipped."""
