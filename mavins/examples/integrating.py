"""The error-state filter `eskf` on IMU increments instead of samples, with GNSS noise that lasts from fix to fix.

Integrals of rate and specific force over an interval go exactly into the same prediction as samples do. The noise of
GNSS is a first-order Markov process, m <- rho m + w: a state for each of a fix's components at the end of x and P,
which the fixes see in addition; R is what is left of white noise.
Sources: Savage (1998) for increments; Groves (2013), section 3.4.3, for correlated noise as states.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mavins.aiding import gnss_position, gnss_velocity, zero_velocity
from mavins.filters.eskf import fuse
from mavins.filters.walking import put_row
from mavins.nav.ins import increments_from_integrals, predict, workspace
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE, X_SIZE, X_TAU
from mavins.types import FloatArray, IntArray

WHITE: Final = 0.1
"""The part of the GNSS noise (m, m/s) that is new with each fix: it keeps the update well conditioned."""
STILL_SPEED: Final = 0.3
STILL_ACCEL: Final = 0.1
"""The vehicle stands where its speed (m/s) and its specific force along either level axis (m/s^2) are below these."""


@kernel
def decay(x: FloatArray, P: FloatArray, sigma: FloatArray, rho: float) -> None:
    """One fix interval of the noise states, the last of x and P, whose stationary 1-sigma is `sigma` (m,)."""
    m, n = len(sigma), P.shape[0]
    for i in range(m):
        x[X_SIZE + i] *= rho
        for j in range(n):
            P[n - m + i, j] *= rho
            P[j, n - m + i] *= rho
    for i in range(m):
        P[n - m + i, n - m + i] += (1.0 - rho * rho) * sigma[i] * sigma[i]


@kernel
def fuse_fix(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    z: FloatArray,
    late: float,
    around: FloatArray,
    columns: IntArray,
) -> float:
    """A fix z (3: p_n, or 6: and v_l) of which the state is `late` s before the stamp; returns the NIS.

    `around` (12,) is what the velocity model needs beside the state.
    """
    m = len(z)
    r = np.empty(m)
    H = np.zeros((m, CANONICAL_SIZE + m))
    for first in range(0, m, 3):
        if first == 0:
            part, H_part = gnss_position.model(x, u, z[:3], np.array([late]))
        else:
            part, H_part = gnss_velocity.model(x, u, z[3:], around)
        for i in range(3):
            k = first + i
            r[k] = part[i] - x[X_SIZE + k]
            H[k, CANONICAL_SIZE + k] = 1.0
            for j in range(CANONICAL_SIZE):
                H[k, j] = H_part[i, j]
    return fuse(x, P, r, H, np.eye(m) * (WHITE * WHITE), columns, np.inf, np.empty((m, m)))


@kernel
def stands(x: FloatArray, u: FloatArray) -> bool:
    """True where neither the estimate moves nor the accelerometers feel it gain speed."""
    speed = math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])
    return speed < STILL_SPEED and math.fabs(u[3]) < STILL_ACCEL and math.fabs(u[4]) < STILL_ACCEL


@kernel
def fuse_standing(
    x: FloatArray, P: FloatArray, u: FloatArray, sigma: float, columns: IntArray
) -> None:
    """Zero velocity with a 1-sigma of `sigma` m/s."""
    r, H_part = zero_velocity.model(x, u, np.zeros(3), np.empty(0))
    H = np.zeros((3, len(x) - 1))
    for i in range(3):
        for j in range(CANONICAL_SIZE):
            H[i, j] = H_part[i, j]
    fuse(x, P, r, H, np.eye(3) * (sigma * sigma), columns, np.inf, np.empty((3, 3)))


@kernel
def run_through(
    x: FloatArray,
    P: FloatArray,
    columns: IntArray,
    increments: FloatArray,
    step_us: int,
    noise: FloatArray,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    fixes: FloatArray,
    around: FloatArray,
    fix_sigma: FloatArray,
    rho: float,
    still_sigma: float,
    every: int,
    out_t: IntArray,
    out_x: FloatArray,
    out_u: FloatArray,
    out_P: FloatArray,
) -> None:
    """Through increments (N, 6) over `step_us` each, with fixes (M, m) stamped 0, 1, 2 .. s; a row each `every`.

    A fix is fused at the sample nearest to its stamp minus the delay that is believed then; the rest, less than half a
    sample, is in its model. With each goes a zero velocity where the vehicle stands (never, where still_sigma is 0).
    """
    work = workspace(P.shape[0], False)
    h = step_us * 1e-6
    u = np.empty(6)
    before = increments[0]
    fix, row = 0, 0
    last = len(increments) - 1
    for k in range(last + 1):
        now = increments[k]
        phi, dv = increments_from_integrals(
            (before[0] - h * x[10], before[1] - h * x[11], before[2] - h * x[12]),
            (before[3] - h * x[13], before[4] - h * x[14], before[5] - h * x[15]),
            (now[0] - h * x[10], now[1] - h * x[11], now[2] - h * x[12]),
            (now[3] - h * x[13], now[4] - h * x[14], now[5] - h * x[15]),
        )
        predict(x, P, phi, dv, h, noise, 1.0, r0_e, C_ne, w_ie_n, work)
        before = now
        t = (k + 1) * h
        if fix < len(fixes) and fix - x[X_TAU] < t + 0.5 * h:
            for i in range(6):
                u[i] = 0.5 * (now[i] + increments[min(k + 1, last), i]) / h
            decay(x, P, fix_sigma, rho)
            fuse_fix(x, P, u, fixes[fix], fix - t, around[fix], columns)
            if still_sigma > 0.0 and stands(x, u):
                fuse_standing(x, P, u, still_sigma, columns)
            fix += 1
        if (k + 1) % every == 0:
            put_row(out_t, out_x, out_u, out_P, row, (k + 1) * step_us, x, u, P)
            row += 1
