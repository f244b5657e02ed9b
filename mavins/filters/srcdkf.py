"""The square-root central-difference Kalman filter on the manifold: no Jacobian, no Cholesky factor in its loop.

In place of P it keeps S, lower triangular, P = S^T S. Sigma points x [+] (+- h s_i), h^2 = 3, lie along the rows of S
(sigma_points.py); what is left of them after an interval, or in a measurement's columns, orthogonal transformations
make a triangle again (nav/square_root.py).

15 states, p_n, v_n, theta_b, b_g, b_a, and further blocks of its layout, except gravity's direction. Sources:
Norgaard, Poulsen and Ravn (2000); van der Merwe (2004), chapter 3;
Kailath, Sayed and Hassibi (2000), chapter 12. Theory: docs/theory/srcdkf.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.filters.base import FilterState, ImuNoise, Observation, Outcome, RowBlock
from mavins.filters.settings import FilterSettings
from mavins.filters.sigma_points import (
    FIRST,
    MEAN,
    SECOND,
    H,
    Scratch,
    propagate,
    propagate_fully,
    scratch,
)
from mavins.filters.walking import (
    is_due,
    noise_scale,
    pieces_of,
    put_row,
    reading_at,
    reading_within,
)
from mavins.nav.deviations import write_interval
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import CORE_SIZE, increments_from_rates, mechanize
from mavins.nav.kernels import kernel
from mavins.nav.layout import TAU, X_TAU, Layout, boxplus
from mavins.nav.linalg import cholesky
from mavins.nav.square_root import (
    WIDTH,
    add_deviation,
    deviations,
    root_of,
    square_of,
    take_triangle,
    triangularize,
    turn_attitude_deviations,
)
from mavins.types import FloatArray, IntArray


@kernel
def step(
    x: FloatArray,
    S: FloatArray,
    u: FloatArray,
    row: FloatArray,
    dt_us: int,
    noise: FloatArray,
    full: bool,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    columns: IntArray,
    work: Scratch,
) -> None:
    """Move x and S, in place, from the reading `u` to the reading `row` (6,) that follows it by dt_us; u <- row."""
    C, mean, i = work[0], work[4], work[8]
    pieces = pieces_of(dt_us)
    dt = dt_us * 1e-6 / pieces
    scale = noise_scale(dt_us)
    w0, f0 = reading_within(x, u, row, 0.0, dt_us)
    for k in range(pieces):
        w1, f1 = reading_within(x, u, row, (k + 1.0) / pieces, dt_us)
        phi, dv = increments_from_rates(w0, f0, w1, f1, dt)
        middle = (
            x[0] + 0.5 * dt * x[3],
            x[1] + 0.5 * dt * x[4],
            x[2] + 0.5 * dt * x[5],
        )
        g = mechanize(x, phi, dv, dt, r0_e, C_ne, w_ie_n, C)
        write_interval(i, w0, f0, w1, f1, phi, dv, dt, middle, g, w_ie_n, C)
        if full:
            propagate_fully(S, noise, scale, r0_e, C_ne, work)
        else:
            propagate(S, noise, scale, r0_e, C_ne, work)
        for j in range(4, len(noise)):
            add_deviation(S, CORE_SIZE - 4 + j, noise[j] * math.sqrt(dt), work[2])
        boxplus(x, mean, columns)
        w0, f0 = w1, f1
    for c in range(6):
        u[c] = row[c]


@kernel
def walk_rows(
    x: FloatArray,
    P: FloatArray,
    S: FloatArray,
    u: FloatArray,
    start_us: int,
    t_us: IntArray,
    imu: FloatArray,
    noise: FloatArray,
    full: bool,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    columns: IntArray,
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
    work = scratch(S.shape[0])
    earth = (r0_e, C_ne, w_ie_n)
    t = start_us
    before = previous_us
    for k in range(len(t_us)):
        if t_us[k] > until_us:
            if until_us > t:
                reading = reading_at(u, imu[k], (until_us - t) / (t_us[k] - t))
                step(x, S, u, reading, until_us - t, noise, full, *earth, columns, work)
            break
        step(x, S, u, imu[k], t_us[k] - t, noise, full, *earth, columns, work)
        t = t_us[k]
        if is_due(t, before, grid_us):
            square_of(P, S)
            put_row(out_t, out_x, out_u, out_P, count, t, x, u, P)
            count += 1
        before = t
    square_of(P, S)
    return count


@kernel
def sigma_points(x: FloatArray, S: FloatArray, columns: IntArray) -> FloatArray:
    """The nominal states (2 n, 26) of x [+] h s_i, then of x [+] -h s_i."""
    n = S.shape[0]
    X = np.empty((2 * n, len(x)))
    e = np.empty(n)
    for j in range(2 * n):
        for c in range(len(x)):
            X[j, c] = x[c]
        for c in range(n):
            e[c] = H * S[j, c] if j < n else -H * S[j - n, c]
        boxplus(X[j], e, columns)
    return X


@kernel
def fuse(
    x: FloatArray,
    P: FloatArray,
    S: FloatArray,
    r: FloatArray,
    D: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    covariance: FloatArray,
) -> float:
    """Gated update of x, P and S in place; returns the NIS.

    r (m,) is the residual at x, D (2 n, m) how far those of the sigma points are from it; r <- the innovation, which
    the measurement's mean is taken for, `covariance` (m, m) <- its covariance. One array of deviations over state and
    measurement holds it all: triangular in the measurement's columns it gives the innovation's root and the gain, and
    what is left below is the state's root afterwards.
    """
    n, m = S.shape[0], len(r)
    second, end = m + n, m + 2 * n
    M, t = deviations(end), np.empty(WIDTH)
    L = np.empty((m, m))
    for i in range(m):
        for k in range(m):
            covariance[i, k] = math.nan
    if not cholesky(L, R):
        return math.nan
    for i in range(m):
        L[i, i] = 1.0 / L[i, i]
        for k in range(i + 1):
            M[k, n + i] = L[i, k]
    for j in range(n):
        for c in range(j + 1):
            M[m + j, c] = S[j, c]
        for i in range(m):
            odd, even = 0.5 * (D[n + j, i] - D[j, i]), 0.5 * (D[n + j, i] + D[j, i])
            M[m + j, n + i] = FIRST * odd
            M[second + j, n + i] = SECOND * even
            r[i] += MEAN * even
    triangularize(M, 0, end, n + m - 1, m, t)
    y = np.empty(m)
    nis = 0.0
    for k in range(m):
        i = m - 1 - k
        s = r[i]
        for done in range(k):
            s -= y[done] * M[done, n + i]
        y[k] = s / M[k, n + i]
        nis += y[k] * y[k]
    for i in range(m):
        for j in range(i + 1):
            s = 0.0
            for k in range(m - i):
                s += M[k, n + i] * M[k, n + j]
            covariance[i, j] = covariance[j, i] = s
    if not nis <= gate:
        return nis
    d = np.zeros(n)
    for k in range(m):
        for c in range(n):
            d[c] += y[k] * M[k, c]
    turn_attitude_deviations(M, m, end, d[6], d[7], d[8])
    triangularize(M, m, end, n - 1, n, t)
    for c in range(n):
        s = math.fabs(M[m + n - 1 - c, c])
        if not (s > 0.0 and s < np.inf and math.fabs(d[c]) < np.inf):
            return math.nan
    take_triangle(S, M, m, n - 1, n)
    square_of(P, S)
    boxplus(x, d, columns)
    return nis


class Srcdkf:
    """The square-root central-difference filter behind the estimator's `Filter` interface.

    FilterState.own is S (n, n), lower triangular with P = S^T S.
    """

    def __init__(self, noise: ImuNoise, layout: Layout, settings: FilterSettings) -> None:
        self.layout = layout
        self._noises = noise.as_arrays(layout)
        self._full = settings.srcdkf.full
        self._tau = np.flatnonzero(layout.columns == TAU.start)

    def adopt(self, state: FilterState) -> None:
        """Find the root of P: the only Cholesky factor of a covariance here."""
        S = np.zeros_like(state.P)
        if not root_of(S, state.P):
            S[:] = math.nan
        state.own = S

    def complaint(self, state: FilterState) -> str:
        """A covariance that was adopted without being positive definite has no root."""
        return "" if math.isfinite(state.own[0, 0]) else "the covariance is not positive definite"

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
        clipped: bool = False,
    ) -> None:
        """Move through IMU rows."""
        rows.count = walk_rows(
            state.x,
            state.P,
            state.own,
            state.u,
            state.t_us,
            t_us,
            imu,
            self._noises[clipped],
            self._full,
            frame.r0_e,
            frame.C_ne,
            frame.w_ie_n,
            self.layout.columns,
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
        columns = self.layout.columns
        r, J = observation.linearize(state.x, state.u)
        if len(columns) + len(r) > WIDTH:
            raise ValueError(f"at most {WIDTH - len(columns)} rows at once, not {len(r)}")
        X = sigma_points(state.x, state.own, columns)
        # the delay enters through its Jacobian: a model may not see it, or weigh it by what of the motion is signal
        X[:, X_TAU] = state.x[X_TAU]
        D = observation.differences(X, state.u, r)
        for j in self._tau:
            first = H * np.outer(state.own[:, j], J[:, TAU.start])
            D -= np.concatenate([first, -first])
        innovation, S = r.copy(), np.empty((len(r), len(r)))
        nis = fuse(state.x, state.P, state.own, innovation, D, observation.R, columns, gate, S)
        return Outcome(nis, innovation, S)
