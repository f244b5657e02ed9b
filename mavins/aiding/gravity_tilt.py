"""Gravity tilt: while the vehicle does not accelerate, the specific force is gravity's reaction alone.

    h = C_nb^T (-g_n(p)) + b_a,   H_p = -C_nb^T dg_n/dp,   H_theta = [C_nb^T (-g_n)]x,   H_ba = I,
    H_g = -C_nb^T dg_n/d(its direction) (nav/s2.py)

Source: Groves (2013), section 5.6.2. Theory: docs/theory/gravity_tilt.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.earth import TangentFrame, gravity_n, write_gravity_gradient
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.s2 import tilted, write_gravity_jacobian
from mavins.nav.so3 import quat_to_dcm, skew
from mavins.types import FloatArray

NAME = "gravity_tilt"
RANK = 7


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (3,) in m/s^2 in b and Jacobian (3, 25); `parameters` is r0_e (3), then C_ne (9, row-major)."""
    C = quat_to_dcm(x[6:10])
    normal = gravity_n(x[0:3], parameters[:3], parameters[3:12].reshape(3, 3))
    tilt = (x[24], x[25])
    g_n = tilted(tilt, (normal[0], normal[1], normal[2]))
    K = np.empty((3, 2))
    write_gravity_jacobian(K, tilt, g_n)
    push_b = np.empty(3)
    for i in range(3):
        push_b[i] = -(C[0, i] * g_n[0] + C[1, i] * g_n[1] + C[2, i] * g_n[2])
    S, G = skew(push_b), np.empty((3, 3))
    write_gravity_gradient(G, g_n[0], g_n[1], g_n[2])
    r = np.empty(3)
    H = np.zeros((3, CANONICAL_SIZE))
    for i in range(3):
        r[i] = z[i] - push_b[i] - x[13 + i]
        H[i, 12 + i] = 1.0
        for j in range(3):
            H[i, j] = -(C[0, i] * G[0, j] + C[1, i] * G[1, j] + C[2, i] * G[2, j])
            H[i, 6 + j] = S[i, j]
        for j in range(2):
            H[i, 23 + j] = -(C[0, i] * K[0, j] + C[1, i] * K[1, j] + C[2, i] * K[2, j])
    return r, H


def measure(
    stamp_us: int, t_us: int, accel_b: FloatArray, frame: TangentFrame, sigma: float, gate: float
) -> Measurement:
    """A specific force (3,) as read, of a vehicle that does not accelerate at `t_us`; 1-sigma noise in m/s^2."""
    return Measurement(
        NAME,
        RANK,
        "unaccelerated",
        stamp_us,
        t_us,
        accel_b,
        np.eye(3) * sigma**2,
        frame.parameters,
        model,
        gate,
    )
