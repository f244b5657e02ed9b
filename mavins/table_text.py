"""A table of numbers as CSV text with fixed decimals, compiled: a flight has hundreds of thousands of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavins.nav.kernels import kernel
from mavins.types import FloatArray, IntArray

WIDEST = 24
"""Characters that one number with its separator takes at the most."""
_COMMA, _LINE, _MINUS, _POINT, _ZERO = (ord(c) for c in ",\n-.0")
_LARGEST = 9.0e18


@kernel
def _put_digits(out: NDArray[np.uint8], at: int, value: int, least: int) -> int:
    """Write a number that is not negative with at least so many digits; returns where it ends."""
    digits = least
    rest = value
    for _ in range(least):
        rest //= 10
    while rest > 0:
        digits += 1
        rest //= 10
    for k in range(at + digits - 1, at - 1, -1):
        out[k] = _ZERO + value % 10
        value //= 10
    return at + digits


@kernel
def _put_rows(t_us: IntArray, rows: FloatArray, decimals: IntArray, out: NDArray[np.uint8]) -> int:
    """Write all lines; returns how many characters. What is not finite, or too large for 64 bits, stays empty."""
    at = 0
    for k in range(len(t_us)):
        if t_us[k] < 0:
            out[at] = _MINUS
            at += 1
        at = _put_digits(out, at, abs(t_us[k]), 1)
        for j in range(len(decimals)):
            out[at] = _COMMA
            at += 1
            unit = 1
            for _ in range(decimals[j]):
                unit *= 10
            scaled = np.floor(abs(rows[k, j]) * unit + 0.5)
            if not scaled < _LARGEST:
                continue
            n = int(scaled)
            if rows[k, j] < 0.0 and n > 0:
                out[at] = _MINUS
                at += 1
            at = _put_digits(out, at, n // unit, 1)
            if decimals[j] > 0:
                out[at] = _POINT
                at = _put_digits(out, at + 1, n % unit, decimals[j])
        out[at] = _LINE
        at += 1
    return at


def csv_lines(t_us: IntArray, rows: FloatArray, decimals: IntArray) -> bytes:
    """Lines `t_us,number,...` for integers t_us (N,) and rows (N, M), column j with decimals[j] (at most 17) decimals.

    Halves are rounded away from zero; there is no "-0". A number that is not finite leaves its field empty.
    """
    out: NDArray[Any] = np.empty((len(t_us), (rows.shape[1] + 1) * WIDEST), dtype=np.uint8)
    flat = out.reshape(-1)
    return flat[: _put_rows(t_us, rows, decimals, flat)].tobytes()


def rounded(values: FloatArray, decimals: int) -> FloatArray:
    """The numbers (N,) that `csv_lines` writes with so many decimals; nan for an empty field."""
    unit = 10.0**decimals
    scaled = np.floor(abs(values) * unit + 0.5)
    return np.where(scaled < _LARGEST, np.copysign(scaled, values) / unit + 0.0, np.nan)
