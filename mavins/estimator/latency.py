"""What an estimated GNSS delay needs to know of the motion around a fix.

A delay shows through the velocity v and the acceleration a: H_tau of a position is -v, that of a velocity -a. Both are
estimates. Their errors look like motion, and a filter that takes them at face value becomes sure of a delay while the
vehicle stands. So the acceleration is a mean over the time in which the fix may lie, and H_a is weighted by the share
of a^2 that is not its own variance. Theory: docs/theory/gnss.md.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.standing import mean_rows
from mavins.filters.base import FilterState
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.kernels import kernel
from mavins.nav.s2 import tilted
from mavins.nav.so3 import quat_to_dcm
from mavins.types import FloatArray

AROUND_US: Final = 200_000
"""The mean is over this long before and after a fix: two sigmas of a delay that is not known yet."""


def delay_parameters(
    state: FilterState, frame: TangentFrame, buffer: ImuBuffer, t_us: int
) -> FloatArray:
    """(8,): the delay in s that is believed, the mean IMU reading around t_us (6), the weight of the acceleration."""
    end = buffer.row_after(t_us + AROUND_US)
    first = max(buffer.first, min(buffer.row_after(t_us - AROUND_US), end - 1))
    parameters = np.empty(8)
    write_parameters(
        parameters, state.x, state.P, buffer.readings(first, end), frame.r0_e, frame.C_ne
    )
    return parameters


@kernel
def signal_share(x: FloatArray, P: FloatArray, f_b: FloatArray, g_n: FloatArray) -> float:
    """a^2 / (a^2 + var a) of a = C_nb f_b + g_n, with d a = -C_nb ([f_b]x theta_b + d b_a)."""
    a = quat_to_dcm(x[6:10]) @ f_b + g_n
    S = np.array([[0.0, -f_b[2], f_b[1]], [f_b[2], 0.0, -f_b[0]], [-f_b[1], f_b[0], 0.0]])
    variance = 0.0
    for i in range(3):
        variance += P[12 + i, 12 + i]
        for j in range(3):
            variance += 2.0 * S[i, j] * P[6 + j, 12 + i]
            for k in range(3):
                variance += S[i, j] * P[6 + j, 6 + k] * S[i, k]
    square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    share: float = square / (square + max(variance, 0.0))
    return share


@kernel
def write_parameters(
    parameters: FloatArray,
    x: FloatArray,
    P: FloatArray,
    rows: FloatArray,
    r0_e: FloatArray,
    C_ne: FloatArray,
) -> None:
    """All of `delay_parameters` from the IMU rows (N, 6) around the fix."""
    mean = mean_rows(rows)
    parameters[0] = x[19]
    for i in range(6):
        parameters[1 + i] = mean[i]
    normal = gravity_n(x[:3], r0_e, C_ne)
    g_n = np.array(tilted((x[24], x[25]), (normal[0], normal[1], normal[2])))
    parameters[7] = signal_share(x, P, mean[3:] - x[13:16], g_n)
