"""Text files of nothing but numbers: a row per line, separated by blanks or commas, comments after # or %.

Lines that are damaged are left out and counted, as is what comes after the place where a packed file breaks off.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs.packed import fault_of, open_packed
from mavins.types import FloatArray

_HEAD: Final = 8192
_COMMENTS: Final = (b"#", b"%")


@dataclass(frozen=True, slots=True)
class NumberText:
    """Rows (N, m), the first comment if there is one, and how many lines are no row of m numbers."""

    rows: FloatArray
    header: str
    bad_lines: int


def head_of(path: Path) -> FloatArray | None:
    """The first rows of a file of numbers; None for any other file."""
    try:
        with open_packed(path) as stream:
            head = stream.read(_HEAD)
    except LogFormatError:
        return None
    lines = head.split(b"\n")
    if len(head) == _HEAD:
        lines.pop()  # it may not be whole
    if b"\0" in head:
        return None
    rows = [_numbers(line) for line in lines if _is_row(line)][:100]
    if not rows or rows[0] is None:
        return None
    whole = [row for row in rows if row is not None and len(row) == len(rows[0])]
    return np.array(whole) if 2 * len(whole) > len(rows) else None


def read_numbers(path: Path) -> NumberText:
    """All rows that have as many numbers as the first ones; LogFormatError where there is none."""
    head = head_of(path)
    if head is None:
        raise LogFormatError(f"{path} is not a text file of numbers")
    width = head.shape[1]
    with open_packed(path) as stream:
        data = stream.read().replace(b",", b" ").replace(b"\r\n", b"\n")
        bad = int(bool(fault_of(stream)))
    first, _, _ = data.partition(b"\n")
    header = first.decode("latin-1") if first.lstrip().startswith(_COMMENTS) else ""
    try:
        rows = np.loadtxt(io.BytesIO(data), comments=["#", "%"], ndmin=2)
        if rows.shape[1] == width:
            return NumberText(rows, header, bad)
    except ValueError:
        pass
    found = [_numbers(line) for line in data.split(b"\n") if _is_row(line)]
    whole = [row for row in found if row is not None and len(row) == width]
    return NumberText(np.array(whole), header, bad + len(found) - len(whole))


def _is_row(line: bytes) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(_COMMENTS)


def _numbers(line: bytes) -> list[float] | None:
    try:
        return [float(text) for text in line.replace(b",", b" ").split()]
    except ValueError:
        return None
