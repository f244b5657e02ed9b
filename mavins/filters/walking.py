"""What every filter's walk over IMU rows shares: intervals, gaps, the last piece of an interval, output rows.

A filter's `walk_rows` is a loop of these around its own step; kernels cannot take a step as an argument and still be
cached, so the loop itself stands in each filter.
"""

from __future__ import annotations

import numpy as np

from mavins.filters.base import GAP_NOISE
from mavins.nav.ins import Vector
from mavins.nav.kernels import kernel
from mavins.types import FloatArray, IntArray

HOLD_US = 200_000
"""Across a longer gap between samples the older reading is held rather than joined to the newer by a line."""
SUBSTEP = 0.1
"""A longer interval (s) is cut: the error dynamics are linearized over one step."""


@kernel
def pieces_of(dt_us: int) -> int:
    """Into how many equal pieces an interval is cut."""
    return 1 + int((dt_us - 1) // (SUBSTEP * 1e6))


@kernel
def noise_scale(dt_us: int) -> float:
    """How much larger than configured the root PSDs of gyro and accelerometer are over an interval."""
    return GAP_NOISE if dt_us > HOLD_US else 1.0


@kernel
def reading_within(
    x: FloatArray, u: FloatArray, row: FloatArray, s: float, dt_us: int
) -> tuple[Vector, Vector]:
    """(w_b, f_b), corrected by the biases in x, at the share s of an interval from reading `u` to reading `row`."""
    if dt_us > HOLD_US:
        s = 0.0
    return (
        (
            u[0] + s * (row[0] - u[0]) - x[10],
            u[1] + s * (row[1] - u[1]) - x[11],
            u[2] + s * (row[2] - u[2]) - x[12],
        ),
        (
            u[3] + s * (row[3] - u[3]) - x[13],
            u[4] + s * (row[4] - u[4]) - x[14],
            u[5] + s * (row[5] - u[5]) - x[15],
        ),
    )


@kernel
def reading_at(u: FloatArray, row: FloatArray, s: float) -> FloatArray:
    """The reading (6,) at the share s of the way from `u` to `row`."""
    reading = np.empty(6)
    for i in range(6):
        reading[i] = u[i] + s * (row[i] - u[i])
    return reading


@kernel
def is_due(t_us: int, before_us: int, grid_us: int) -> bool:
    """True where a row is to be written at t_us, the sample before it being at before_us (see Filter.walk)."""
    return grid_us == 0 or (grid_us > 0 and t_us // grid_us > before_us // grid_us)


@kernel
def put_row(
    out_t: IntArray,
    out_x: FloatArray,
    out_u: FloatArray,
    out_P: FloatArray,
    place: int,
    t_us: int,
    x: FloatArray,
    u: FloatArray,
    P: FloatArray,
) -> None:
    """Write one estimate into the arrays of a RowBlock; P is over canonical errors."""
    # element by element: numba takes long to compile an assignment of slices
    out_t[place] = t_us
    for i in range(len(x)):
        out_x[place, i] = x[i]
    for i in range(len(u)):
        out_u[place, i] = u[i]
    for i in range(out_P.shape[1]):
        for j in range(out_P.shape[2]):
            out_P[place, i, j] = P[i, j]
