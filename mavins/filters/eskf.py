"""The error-state Kalman filter: strapdown mechanization, a covariance over its errors, feedback at each update.

15 states, p_n, v_n, theta_b, b_g, b_a, and all further blocks of its layout. Sources: Sola (2017), sections 5 to 7;
Groves (2013), chapter 14.
Theory: docs/theory/eskf.md.
"""

from __future__ import annotations

import numpy as np

from mavins.filters.base import FilterState, ImuNoise, Observation, Outcome, RowBlock
from mavins.filters.settings import FilterSettings
from mavins.filters.walking import (
    is_due,
    noise_scale,
    pieces_of,
    put_row,
    reading_at,
    reading_within,
)
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import Workspace, increments_from_rates, predict, workspace
from mavins.nav.kernels import kernel
from mavins.nav.layout import Layout, boxplus
from mavins.nav.linalg import gated_update, reset_attitude_error
from mavins.types import FloatArray, IntArray


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
    pieces = pieces_of(dt_us)
    h = dt_us * 1e-6 / pieces
    scale = noise_scale(dt_us)
    w0, f0 = reading_within(x, u, row, 0.0, dt_us)
    for i in range(pieces):
        w1, f1 = reading_within(x, u, row, (i + 1.0) / pieces, dt_us)
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
    has_gravity: bool,
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
    work = workspace(P.shape[0], has_gravity)
    t = start_us
    before = previous_us
    for k in range(len(t_us)):
        if t_us[k] > until_us:
            if until_us > t:
                reading = reading_at(u, imu[k], (until_us - t) / (t_us[k] - t))
                step(x, P, u, reading, until_us - t, noise, r0_e, C_ne, w_ie_n, work)
            break
        step(x, P, u, imu[k], t_us[k] - t, noise, r0_e, C_ne, w_ie_n, work)
        t = t_us[k]
        if is_due(t, before, grid_us):
            put_row(out_t, out_x, out_u, out_P, count, t, x, u, P)
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
    S: FloatArray,
) -> float:
    """Gated update of P, feedback of the correction into x, reset of the attitude error; returns the NIS."""
    d = np.empty(P.shape[0])
    nis = gated_update(P, r, H, R, columns, gate, d, S)
    if nis <= gate:
        boxplus(x, d, columns)
        reset_attitude_error(P, d[6:9])
    return nis


class Eskf:
    """The error-state Kalman filter behind the estimator's `Filter` interface."""

    def __init__(self, noise: ImuNoise, layout: Layout, settings: FilterSettings) -> None:
        self.layout = layout
        self.noise = noise.as_array(layout)

    def adopt(self, state: FilterState) -> None:
        """Nothing to do: the state is all that this filter has."""

    def complaint(self, state: FilterState) -> str:
        """No state is beyond this filter."""
        return ""

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
            self.noise,
            self.layout.has_gravity,
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

    def update(self, state: FilterState, observation: Observation, gate: float) -> Outcome:
        """Fuse a measurement."""
        r, H = observation.linearize(state.x, state.u)
        S = np.empty((len(r), len(r)))
        nis = fuse(state.x, state.P, r, H, observation.R, self.layout.columns, gate, S)
        return Outcome(nis, r, S)
