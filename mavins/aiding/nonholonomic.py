"""Wheels: where they touch the ground a vehicle moves neither sideways nor up or down.

    h = S (C_nb^T v_n + [w]x l_b),   z = 0,   w = w_b - b_g,   S the rows of right and down
    H_v = S C_nb^T,   H_theta = S [C_nb^T v_n]x,   H_bg = S [l_b]x

l_b is the lever arm from the IMU to the axle that does not steer. Source: Groves (2013), section 15.4.1.
Theory: docs/theory/nonholonomic.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.so3 import cross, quat_to_dcm, skew
from mavins.types import FloatArray

NAME = "nonholonomic"
RANK = 8


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (2,) in m/s in b and Jacobian (2, 25); `parameters` is the lever arm l_b (3)."""
    C = quat_to_dcm(x[6:10])
    v_b = np.empty(3)
    for i in range(3):
        v_b[i] = C[0, i] * x[3] + C[1, i] * x[4] + C[2, i] * x[5]
    swing_b = cross(u[0:3] - x[10:13], parameters)
    S_v, S_l = skew(v_b), skew(parameters)
    r = np.empty(2)
    H = np.zeros((2, CANONICAL_SIZE))
    for i in range(2):
        r[i] = z[i] - v_b[1 + i] - swing_b[1 + i]
        for j in range(3):
            H[i, 3 + j] = C[j, 1 + i]
            H[i, 6 + j] = S_v[1 + i, j]
            H[i, 9 + j] = S_l[1 + i, j]
    return r, H


def measure(
    stamp_us: int, t_us: int, lever_b: FloatArray, sigma: float, gate: float
) -> Measurement:
    """Rolling without slip at `t_us`, with a 1-sigma noise in m/s."""
    return Measurement(
        NAME,
        RANK,
        "wheels",
        stamp_us,
        t_us,
        np.zeros(2),
        np.eye(2) * sigma**2,
        lever_b,
        model,
        gate,
    )
