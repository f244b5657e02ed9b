"""Estimates and innovations as Parquet: the columns of the CSV files, a block at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from mavins.evaluation.result_folder import Result

FILES: Final = ("estimates.parquet", "innovations.parquet")
NEEDS: Final = ("pyarrow",)
_WORDS: Final = ("aiding", "source", "reason")
_WHOLE: Final = ("t_us", "stamp_us")


def write(result: Result, folder: Path) -> None:
    """Write estimates.parquet and innovations.parquet."""
    for name in FILES:
        _convert((result.folder / result.filter / name).with_suffix(".csv"), folder / name)


def _convert(source: Path, target: Path) -> None:
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pq

    with source.open(encoding="ascii") as file:
        names = file.readline().strip().split(",")
    schema = pa.schema([pa.field(name, _type(pa, name)) for name in names])
    words = [name for name in names if name in _WORDS]
    options = pa_csv.ConvertOptions(
        column_types=schema,
        null_values=[""],
        strings_can_be_null=False,
        true_values=["1"],
        false_values=["0"],
    )
    with (
        pa_csv.open_csv(source, convert_options=options) as blocks,
        # a dictionary of numbers that hardly repeat would take three times as long, and more room
        pq.ParquetWriter(target, schema, compression="zstd", use_dictionary=words) as file,
    ):
        for block in blocks:
            file.write_batch(block)


def _type(pa: Any, name: str) -> Any:
    if name in _WHOLE:
        return pa.int64()
    if name in _WORDS:
        return pa.dictionary(pa.int32(), pa.string())
    return pa.bool_() if name == "accepted" else pa.float64()
