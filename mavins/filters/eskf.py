"""The error-state Kalman filter: strapdown mechanization, a covariance over its errors, feedback at each update.

15 states: p_n, v_n, theta_b, b_g, b_a. Sources: Sola (2017), sections 5 to 7; Groves (2013), chapter 14.
Theory: docs/theory/eskf.md.
"""

from __future__ import annotations

import numpy as np

from mavins.filters.base import FilterState, ImuNoise, RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import CORE_SIZE, Workspace, increments_from_rates, predict, workspace
from mavins.nav.kernels import kernel
from mavins.nav.layout import Layout, boxplus
from mavins.nav.linalg import gated_update, reset_attitude_error
from mavins.types import FloatArray, IntArray

HOLD_US = 200_000
"""Across a longer gap between samples the older reading is held rather than joined to the newer by a line."""
SUBSTEP = 0.1
"""A longer interval (s) is cut: the error dynamics are linearized over one step."""
GAP_NOISE = 10.0
"""The root PSDs of gyro and accelerometer are this many times larger while a reading is held."""


@kernel
def step(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    row: FloatArray,
    dt_us: int,
    noise: FloatArray,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    work: Workspace,
) -> None:
    """Move x and P, in place, from the reading `u` to the reading `row` (6,) that follows it by dt_us; u <- row."""
    dt = dt_us * 1e-6
    held = dt_us > HOLD_US
    pieces = 1 + int((dt_us - 1) // (SUBSTEP * 1e6))
    h = dt / pieces
    bg0, bg1, bg2 = x[10], x[11], x[12]
    ba0, ba1, ba2 = x[13], x[14], x[15]
    scale = GAP_NOISE if held else 1.0
    w0 = (u[0] - bg0, u[1] - bg1, u[2] - bg2)
    f0 = (u[3] - ba0, u[4] - ba1, u[5] - ba2)
    w1, f1 = w0, f0
    for i in range(pieces):
        if not held:
            s = (i + 1.0) / pieces
            w1 = (
                u[0] + s * (row[0] - u[0]) - bg0,
                u[1] + s * (row[1] - u[1]) - bg1,
                u[2] + s * (row[2] - u[2]) - bg2,
            )
            f1 = (
                u[3] + s * (row[3] - u[3]) - ba0,
                u[4] + s * (row[4] - u[4]) - ba1,
                u[5] + s * (row[5] - u[5]) - ba2,
            )
        phi, dv = increments_from_rates(w0, f0, w1, f1, h)
        predict(x, P, phi, dv, h, noise, scale, r0_e, C_ne, w_ie_n, work)
        w0, f0 = w1, f1
    for i in range(6):
        u[i] = row[i]


@kernel
def walk_rows(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    start_us: int,
    t_us: IntArray,
    imu: FloatArray,
    noise: FloatArray,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    until_us: int,
    previous_us: int,
    grid_us: int,
    out_t: IntArray,
    out_x: FloatArray,
    out_u: FloatArray,
    out_P: FloatArray,
    count: int,
) -> int:
    """Walk IMU rows (see Filter.walk); returns how many output rows are filled."""
    work = workspace(P.shape[0])
    t = start_us
    before = previous_us
    for k in range(len(t_us)):
        if t_us[k] > until_us:
            if until_us > t:
                s = (until_us - t) / (t_us[k] - t)
                reading = np.empty(6)
                for i in range(6):
                    reading[i] = u[i] + s * (imu[k, i] - u[i])
                step(x, P, u, reading, until_us - t, noise, r0_e, C_ne, w_ie_n, work)
            break
        step(x, P, u, imu[k], t_us[k] - t, noise, r0_e, C_ne, w_ie_n, work)
        t = t_us[k]
        if grid_us == 0 or (grid_us > 0 and t // grid_us > before // grid_us):
            # element by element: numba takes long to compile an assignment of slices
            out_t[count] = t
            for i in range(len(x)):
                out_x[count, i] = x[i]
            for i in range(len(u)):
                out_u[count, i] = u[i]
            for i in range(CORE_SIZE):
                for j in range(CORE_SIZE):
                    out_P[count, i, j] = P[i, j]
            count += 1
        before = t
    return count


@kernel
def fuse(
    x: FloatArray,
    P: FloatArray,
    r: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    sigma: FloatArray,
) -> float:
    """Gated update of P, feedback of the correction into x, reset of the attitude error; returns the NIS."""
    d = np.empty(P.shape[0])
    nis = gated_update(P, r, H, R, columns, gate, d, sigma)
    if nis <= gate:
        boxplus(x, d, columns)
        reset_attitude_error(P, d[6:9])
    return nis


class Eskf:
    """The error-state Kalman filter behind the estimator's `Filter` interface."""

    def __init__(self, noise: ImuNoise, layout: Layout | None = None) -> None:
        self.layout = layout or Layout.of()
        self._noise = noise.as_array()

    def walk(
        self,
        state: FilterState,
        frame: TangentFrame,
        t_us: IntArray,
        imu: FloatArray,
        until_us: int,
        previous_us: int,
        grid_us: int,
        rows: RowBlock,
    ) -> None:
        """Move through IMU rows."""
        rows.count = walk_rows(
            state.x,
            state.P,
            state.u,
            state.t_us,
            t_us,
            imu,
            self._noise,
            frame.r0_e,
            frame.C_ne,
            frame.w_ie_n,
            until_us,
            previous_us,
            grid_us,
            rows.t_us,
            rows.x,
            rows.u,
            rows.P,
            rows.count,
        )
        state.t_us = until_us

    def update(
        self,
        state: FilterState,
        r: FloatArray,
        H: FloatArray,
        R: FloatArray,
        gate: float,
        sigma: FloatArray,
    ) -> float:
        """Fuse a measurement."""
        return float(fuse(state.x, state.P, r, H, R, self.layout.columns, gate, sigma))
