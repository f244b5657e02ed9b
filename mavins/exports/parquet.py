"""Estimates and innovations as Parquet: the columns of the CSV files, a block at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavins.estimates import Result
from mavins.results import INNOVATIONS, as_shown, columns
from mavins.table_text import rounded

FILES: Final = ("estimates.parquet", "innovations.parquet")
NEEDS: Final = ("pyarrow",)
_ROWS: Final = 1 << 17
"""Of a block."""
_WORDS: Final = ("aiding", "source", "reason")
_WHOLE: Final = ("t_us", "stamp_us")


def write(result: Result, folder: Path) -> None:
    """Write estimates.parquet, to the digits of estimates.csv, and innovations.parquet, one aiding after the other."""
    _write(folder / FILES[0], ["t_us", *columns(result.layout)], _estimates(result))
    _write(folder / FILES[1], INNOVATIONS.split(","), _innovations(result))


def _estimates(result: Result) -> Iterator[list[NDArray[Any]]]:
    for k in range(0, len(result), _ROWS):
        part = slice(k, k + _ROWS)
        shown, decimals = as_shown(result.table[part])
        # digits that nobody needs would take half as much room again
        yield [result.t_us[part], *map(rounded, shown.T, decimals)]


def _innovations(result: Result) -> Iterator[list[NDArray[Any]]]:
    for aiding, m in result.innovations.items():
        lack = np.full((3 - m.rows, len(m)), np.nan)
        head = [m.t_us, m.stamp_us, np.full(len(m), aiding), m.source, m.accepted, m.reason, m.nis]
        yield [*head, *m.innovation.T, *lack, *m.sigma.T, *lack]


def _write(path: Path, names: Sequence[str], blocks: Iterable[list[NDArray[Any]]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema([pa.field(name, _type(pa, name)) for name in names])
    words = [name for name in names if name in _WORDS]
    # a dictionary of numbers that hardly repeat would take three times as long, and more room
    with pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=words) as file:
        for block in blocks:
            arrays = [
                pa.array(values, from_pandas=True).cast(type_)
                for values, type_ in zip(block, schema.types, strict=True)
            ]
            file.write_table(pa.table(arrays, schema=schema))


def _type(pa: Any, name: str) -> Any:
    if name in _WHOLE:
        return pa.int64()
    if name in _WORDS:
        return pa.dictionary(pa.int32(), pa.string())
    return pa.bool_() if name == "accepted" else pa.float64()
