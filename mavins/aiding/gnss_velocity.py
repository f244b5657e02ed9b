"""GNSS velocity of the antenna in the local level frame, with or without its vertical component.

    h = S C_ln (v_n + C_nb [w]x l_b + (tau_0 - tau) s a),   w = w_b - b_g,   S the measured rows (2 or 3)
    H_v = S C_ln,   H_theta = -S C_ln C_nb [w x l_b]x,   H_bg = S C_ln C_nb [l_b]x,   H_l = S C_ln C_nb [w]x,
    H_tau = -S C_ln s a,   a = v' + d/dt (C_nb [w]x l_b) ~ C_nb (f_b - b_a) + g_n + C_nb [w]x [w]x l_b

tau_0 is the delay that the instant of the state was found with (gnss_position.py). Where the delay is estimated, a is
that of a mean reading around the instant, weighted by the share s of it that is signal: noise would pass for
information on the delay (docs/theory/gnss.md). Elsewhere s = 1.
Source: Groves (2013), section 14.3. Theory: docs/theory/gnss.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.earth import TangentFrame, dcm_ln, gravity_n, point_n
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.s2 import tilted
from mavins.nav.so3 import cross, quat_to_dcm
from mavins.types import FloatArray, GnssFix

NAME = "gnss_velocity"
RANK = 1
_NO_DELAY = np.empty(0)
_ISOTROPIC = {m: np.eye(m) for m in (2, 3)}


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (m,) in m/s in l and Jacobian (m, 25), m = 2 or 3.

    `parameters` is C_ln at the fix (9, row-major), then g_n there (3); where the delay is estimated, then tau_0, the
    mean reading (6, as u) and the weight s of the acceleration.
    """
    m = len(z)
    C = quat_to_dcm(x[6:10])
    lever = x[16:19]
    w = u[0:3] - x[10:13]
    swing_b = cross(w, lever)
    estimated = len(parameters) > 12
    late = parameters[12] - x[19] if estimated else 0.0
    weight = parameters[19] if estimated else 1.0
    mean = parameters[13:19] if estimated else u
    mean_w = mean[0:3] - x[10:13]
    turning_b = cross(mean_w, cross(mean_w, lever))
    g_n = tilted((x[24], x[25]), (parameters[9], parameters[10], parameters[11]))
    v = np.empty(3)
    acceleration = np.empty(3)
    for i in range(3):
        v[i] = x[3 + i]
        acceleration[i] = g_n[i]
        for j in range(3):
            v[i] += C[i, j] * swing_b[j]
            acceleration[i] += C[i, j] * (mean[3 + j] - x[13 + j] + turning_b[j])
    r = np.empty(m)
    H = np.zeros((m, CANONICAL_SIZE))
    SC = np.zeros(3)
    for i in range(m):
        r[i] = z[i]
        for j in range(3):
            S_ij = parameters[3 * i + j]
            r[i] -= S_ij * v[j]
            H[i, 18] -= S_ij * acceleration[j]
            H[i, 3 + j] = S_ij
            SC[j] = (
                parameters[3 * i] * C[0, j]
                + parameters[3 * i + 1] * C[1, j]
                + parameters[3 * i + 2] * C[2, j]
            )
        H[i, 18] *= weight
        r[i] += late * H[i, 18]
        # a row s of S C times [a]x is s x a
        d_theta = cross(SC, swing_b)
        d_bias = cross(SC, lever)
        d_lever = cross(SC, w)
        for j in range(3):
            H[i, 6 + j] = -d_theta[j]
            H[i, 9 + j] = d_bias[j]
            H[i, 15 + j] = d_lever[j]
    return r, H


@kernel
def surroundings(
    lat: float, lon: float, alt: float, r0_e: FloatArray, C_ne: FloatArray
) -> FloatArray:
    """The model's parameters (12,) at a place: C_ln, row-major, and g_n."""
    parameters = np.empty(12)
    C_ln = dcm_ln(lat, lon, C_ne)
    g_n = gravity_n(point_n(lat, lon, alt, r0_e, C_ne), r0_e, C_ne)
    for i in range(3):
        for j in range(3):
            parameters[3 * i + j] = C_ln[i, j]
        parameters[9 + i] = g_n[i]
    return parameters


def measure(
    fix: GnssFix,
    t_us: int,
    frame: TangentFrame,
    sigma: float,
    gate: float,
    quality: str = "",
    delay: FloatArray = _NO_DELAY,
) -> Measurement | None:
    """The velocity of a fix valid at `t_us`, with an isotropic 1-sigma noise in m/s; None where the fix has none.

    Where the delay is estimated, `delay` (8,) is what the model needs for it (its last parameters).
    """
    if fix.v_l is None or math.isnan(fix.v_l[0]) or math.isnan(fix.v_l[1]):
        return None
    m = 2 if math.isnan(fix.v_l[2]) else 3
    return Measurement(
        NAME,
        RANK,
        fix.source,
        fix.t_us,
        t_us,
        np.array(fix.v_l[:m]),
        _ISOTROPIC[m] * sigma**2,
        np.concatenate([surroundings(fix.lat, fix.lon, fix.alt, frame.r0_e, frame.C_ne), delay]),
        model,
        gate,
        quality,
    )
