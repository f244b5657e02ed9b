"""The CSV text of tables against Python's own formatting."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mavins.table_text import csv_lines
from mavins.types import FloatArray

DECIMALS = np.array([0, 4, 10], dtype=np.int64)


def lines(*rows: tuple[int, float, float, float]) -> list[str]:
    t_us = np.array([row[0] for row in rows], dtype=np.int64)
    table = np.array([row[1:] for row in rows], dtype=float)
    return csv_lines(t_us, table, DECIMALS).decode().splitlines()


def test_numbers_are_written_with_their_decimals() -> None:
    assert lines((0, 0.0, -1.5, 47.3977432), (-12, 7.5, 0.00004, -0.0)) == [
        "0,0,-1.5000,47.3977432000",
        "-12,8,0.0000,0.0000000000",
    ]


def test_what_is_not_a_number_stays_empty() -> None:
    assert lines((1, math.nan, math.inf, -math.inf)) == ["1,,,"]
    assert lines((1, 1e300, 2.0, -3.0)) == ["1,,2.0000,-3.0000000000"]


def test_an_empty_table_is_empty() -> None:
    assert csv_lines(np.empty(0, dtype=np.int64), np.empty((0, 3)), DECIMALS) == b""


@given(arrays(float, (3, 3), elements=st.floats(-1e8, 1e8)), st.integers(0, 2**62))
def test_reading_gives_the_numbers_back(table: FloatArray, t: int) -> None:
    t_us = np.array([t, t + 1, t + 2], dtype=np.int64)
    text = csv_lines(t_us, table, DECIMALS).decode()
    for line, row, stamp in zip(text.splitlines(), table, t_us, strict=True):
        first, *fields = line.split(",")
        assert int(first) == stamp
        for field, value, decimals in zip(fields, row, DECIMALS, strict=True):
            assert len(field.partition(".")[2]) == decimals
            # half a unit of the last decimal, and what a double itself can hold
            assert abs(float(field) - value) <= 0.5000001 * 10.0**-decimals + 2e-16 * abs(value)
