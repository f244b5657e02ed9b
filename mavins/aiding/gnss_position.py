"""GNSS position: the antenna's place in n.

    h = p_n + C_nb l_b + (tau_0 - tau) s,   s = v_n + C_nb [w]x l_b the antenna's velocity
    H_p = I,   H_v = (tau_0 - tau) I,   H_theta = -C_nb [l_b]x,   H_l = C_nb,   H_tau = -s

The state is that of the instant stamp - tau_0, tau_0 being the delay that was believed when the fix came; what a later
estimate tau differs from it moves the antenna along its velocity.

Source: Groves (2013), section 14.3. Theory: docs/theory/gnss.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.earth import TangentFrame, dcm_ln, point_n
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.so3 import cross, quat_to_dcm, skew
from mavins.types import FloatArray, GnssFix

NAME = "gnss_position"
RANK = 0
_NO_PARAMETERS = np.empty(0)


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (3,) in m in n and Jacobian (3, 25); `parameters` is tau_0, or nothing where it is the state's tau."""
    C = quat_to_dcm(x[6:10])
    lever = x[16:19]
    arm = np.empty(3)
    w_x_l = cross(u[0:3] - x[10:13], lever)
    r = np.empty(3)
    H = np.zeros((3, CANONICAL_SIZE))
    C_l = skew(lever)
    late = parameters[0] - x[19] if len(parameters) else 0.0
    for i in range(3):
        arm[i] = C[i, 0] * lever[0] + C[i, 1] * lever[1] + C[i, 2] * lever[2]
        swing = C[i, 0] * w_x_l[0] + C[i, 1] * w_x_l[1] + C[i, 2] * w_x_l[2]
        r[i] = z[i] - x[i] - arm[i] - late * (x[3 + i] + swing)
        H[i, i] = 1.0
        H[i, 3 + i] = late
        H[i, 18] = -(x[3 + i] + swing)
        for j in range(3):
            H[i, 6 + j] = -(C[i, 0] * C_l[0, j] + C[i, 1] * C_l[1, j] + C[i, 2] * C_l[2, j])
            H[i, 15 + j] = C[i, j]
    return r, H


@kernel
def noise_n(C_ln: FloatArray, sigma_h: float, sigma_v: float) -> FloatArray:
    """R (3, 3) in n of a position with these 1-sigma noises along the local horizontal and vertical."""
    h, v = sigma_h * sigma_h, sigma_v * sigma_v
    R = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            R[i, j] = (v - h) * (C_ln[2, i] * C_ln[2, j])
        R[i, i] += h
    return R


@kernel
def write_place(
    lat: float,
    lon: float,
    alt: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    sigma_h: float,
    sigma_v: float,
    z: FloatArray,
    R: FloatArray,
) -> None:
    """Write z (3,), the place in n, and R (3, 3): one call for what a fix needs."""
    p_n = point_n(lat, lon, alt, r0_e, C_ne)
    R_n = noise_n(dcm_ln(lat, lon, C_ne), sigma_h, sigma_v)
    for i in range(3):
        z[i] = p_n[i]
        for j in range(3):
            R[i, j] = R_n[i, j]


def measure(
    fix: GnssFix,
    t_us: int,
    frame: TangentFrame,
    sigma_h: float,
    sigma_v: float,
    gate: float,
    quality: str = "",
    tau: FloatArray = _NO_PARAMETERS,
) -> Measurement:
    """The position of a fix valid at `t_us`, with 1-sigma noises in m along the local horizontal and vertical.

    `tau` (1,) is the delay in s that `t_us` was found with, where the delay is estimated.
    """
    z, R = np.empty(3), np.empty((3, 3))
    write_place(fix.lat, fix.lon, fix.alt, frame.r0_e, frame.C_ne, sigma_h, sigma_v, z, R)
    return Measurement(
        NAME,
        RANK,
        fix.source,
        fix.t_us,
        t_us,
        z,
        R,
        tau,
        model,
        gate,
        quality,
    )
