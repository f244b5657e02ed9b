"""Tables of numbers in CSV files, plain or in .gz or .xz: a header of column names, then one row per line.

Of a damaged file the error names the file, the line and the column.
"""

from __future__ import annotations

import gzip
import io
import lzma
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

import numpy as np

from mavins.errors import LogFormatError
from mavins.types import FloatArray, IntArray

SUFFIXES: Final = (".csv", ".csv.xz", ".csv.gz")
STAMP: Final = "t_us"
_EXACT: Final = 2.0**53
"""Stamps are read as floats, which hold every integer up to here."""


@dataclass(frozen=True, slots=True)
class CsvTable:
    """N rows in the order of their stamps: `t_us` (N,), and named columns (N,) with NaN where nothing is given."""

    path: Path
    t_us: IntArray
    columns: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(self.t_us)

    def column(self, name: str) -> FloatArray:
        """A column (N,), NaN throughout where the file has none of this name."""
        return self.columns.get(name, np.full(len(self), np.nan))

    def stack(self, *names: str) -> FloatArray:
        """Columns side by side (N, m)."""
        return np.column_stack([self.column(name) for name in names])

    def select(self, rows: IntArray) -> CsvTable:
        """The rows with these numbers."""
        return CsvTable(self.path, self.t_us[rows], {k: v[rows] for k, v in self.columns.items()})


def find_table(folder: Path, name: str) -> Path | None:
    """The file `name`.csv in a folder, plain or compressed; None where there is none."""
    paths = (folder / f"{name}{suffix}" for suffix in SUFFIXES)
    return next((path for path in paths if path.exists()), None)


def read_table(path: Path, needed: Sequence[str], optional: Sequence[str] = ()) -> CsvTable:
    """Read a table as `read_rows` does; its rows are put in the order of their stamps."""
    t_us, names, rows = read_rows(path, needed, optional)
    order = np.argsort(t_us, kind="stable")
    rows = rows[order]
    columns = {name: rows[:, i].copy() for i, name in enumerate(names) if name != STAMP}
    return CsvTable(path, t_us[order], columns)


def read_rows(
    path: Path, needed: Sequence[str], optional: Sequence[str] = ()
) -> tuple[IntArray, list[str], FloatArray]:
    """Stamps (N,), names and rows (N, names) of a table whose header has `t_us` and the `needed` columns, and nothing
    else than `optional` ones.

    An empty field is a value that is not given: nan. Raises LogFormatError.
    """
    data = _content(path).replace(b"\r\n", b"\n")
    head, _, body = data.partition(b"\n")
    names = _names(path, head, needed, optional)
    rows = _numbers(path, names, body)
    where = names.index(STAMP)
    t_us = rows[:, where]
    wrong = ~((t_us >= 0.0) & (t_us < _EXACT) & (np.floor(t_us) == t_us))
    if wrong.any():
        _damaged(path, body, int(np.argmax(wrong)), STAMP, "not a whole number of microseconds")
    infinite = np.isinf(rows)
    if infinite.any():
        row, column = np.argwhere(infinite)[0].tolist()
        _damaged(path, body, row, names[column], "not a finite number")
    return t_us.astype(np.int64), names, rows


def _content(path: Path) -> bytes:
    try:
        data = path.read_bytes()
        if data.startswith(b"\xfd7zXZ\x00"):
            return lzma.decompress(data)
        return gzip.decompress(data) if data.startswith(b"\x1f\x8b") else data
    except (lzma.LZMAError, zlib.error, EOFError, gzip.BadGzipFile) as error:
        raise LogFormatError(f"{path} is damaged: {error}") from error
    except OSError as error:
        raise LogFormatError(f"cannot read {path}: {error.strerror}") from error


def _names(path: Path, head: bytes, needed: Sequence[str], optional: Sequence[str]) -> list[str]:
    known = (STAMP, *needed, *optional)
    names = [
        name.strip() for name in head.removeprefix(b"\xef\xbb\xbf").decode("latin-1").split(",")
    ]
    for number, name in enumerate(names, 1):
        if name not in known or names.index(name) + 1 != number:
            raise LogFormatError(
                f"{path}: line 1, column {number}: {name[:40]!r} is not a column of this table, or comes "
                f"twice; there are: {', '.join(known)}"
            )
    missing = [name for name in (STAMP, *needed) if name not in names]
    if missing:
        raise LogFormatError(f"{path}: line 1: no column {', '.join(missing)}")
    return names


def with_nan(body: bytes) -> bytes:
    """Lines of CSV with `nan` in every empty field: numpy's quick reader knows no empty ones."""
    filled = b"\n" + body + b"\n"
    # twice, because neighbours share a comma
    for empty, nan in (
        (b",,", b",nan,"),
        (b",,", b",nan,"),
        (b",\n", b",nan\n"),
        (b"\n,", b"\nnan,"),
    ):
        filled = filled.replace(empty, nan)
    return filled


def _numbers(path: Path, names: list[str], body: bytes) -> FloatArray:
    """All rows (N, columns)."""
    if not body.strip():
        return np.empty((0, len(names)))
    filled = with_nan(body)
    try:
        rows = np.loadtxt(io.BytesIO(filled), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        _explain(path, names, body)
    if rows.shape[1] != len(names):
        _explain(path, names, body)
    return rows


def _lines(body: bytes) -> Iterator[tuple[int, str]]:
    """The lines that hold a row, numbered as in the file."""
    for number, line in enumerate(body.decode("latin-1").split("\n"), 2):
        if line.strip():
            yield number, line


def _explain(path: Path, names: list[str], body: bytes) -> NoReturn:
    """Find the first field that is no number."""
    for number, line in _lines(body):
        fields = line.split(",")
        if len(fields) != len(names):
            raise LogFormatError(
                f"{path}: line {number} has {len(fields)} columns, the header {len(names)}"
            )
        for name, text in zip(names, fields, strict=True):
            try:
                float(text or "nan")
            except ValueError:
                raise LogFormatError(
                    f"{path}: line {number}, column {name}: {text[:40]!r} is not a number"
                ) from None
    raise LogFormatError(f"{path}: not a table of numbers")


def _damaged(path: Path, body: bytes, row: int, column: str, what: str) -> NoReturn:
    number, line = next(item for i, item in enumerate(_lines(body)) if i == row)
    raise LogFormatError(f"{path}: line {number}, column {column}: {what}: {line[:60]}")
