"""The square-root central-difference Kalman filter on the manifold: no Jacobian, no Cholesky factor in its loop.

Sigma points x [+] (+- h s_i), h^2 = 3, lie along the rows s_i of the square root S, P = S^T S. Their images' first
differences and second differences are new deviations, which orthogonal transformations make a triangle again:

    d_i+- = f(x [+] (+- h s_i)) [-] f(x),   a_i = (d_i+ - d_i-) / 2h,   b_i = sqrt(h^2 - 1) / 2h^2 (d_i+ + d_i-)
    x <- f(x) [+] sum (d_i+ + d_i-) / 2h^2,   S^T S = sum a_i a_i^T + b_i b_i^T

15 states: p_n, v_n, theta_b, b_g, b_a. Sources: Norgaard, Poulsen and Ravn (2000); van der Merwe (2004), chapter 3.
Theory: docs/theory/srcdkf.md.
"""

from __future__ import annotations

import math
from typing import TypeAlias

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
from mavins.nav.deviations import Interval, gravity_change, interval, moved, turned
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import CORE_SIZE, MOVING, Vector, increments_from_rates, mechanize
from mavins.nav.kernels import kernel
from mavins.nav.layout import TAU, Layout, boxplus
from mavins.nav.linalg import cholesky
from mavins.nav.square_root import (
    padded,
    root_of,
    square_of,
    take_triangle,
    triangularize,
    turn_attitude_deviations,
)
from mavins.types import FloatArray, IntArray

H = math.sqrt(3.0)
"""The distance of the sigma points, in sigmas: the fourth moments of a normal distribution are right with it."""
FIRST = 0.5 / H
SECOND = 0.5 * math.sqrt(H * H - 1.0) / (H * H)
MEAN = 0.5 / (H * H)
"""What the first and second differences are multiplied by in the deviations, and the second ones in the mean."""
LINEAR = 6
"""Errors of position and velocity are added: of their sigma points only gravity is not linear."""
BIASES = CORE_SIZE - MOVING
NOISES = 6
"""White noises of gyro and accelerometer, which are errors of the readings over an interval as the biases are."""

Deviation: TypeAlias = tuple[Vector, Vector, Vector]
Scratch: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@kernel
def scratch(n: int) -> Scratch:
    """(C, M, E, mean): C_nb, the deviations after and before an interval, and the mean's shift, for n states."""
    rows = n + NOISES + BIASES
    return (
        np.empty((3, 3)),
        np.zeros((2 * rows, padded(n))),
        np.zeros((rows, CORE_SIZE)),
        np.zeros(n),
    )


# ---- the sigma points of an interval -----------------------------------------------------------------------------


@kernel
def deviation(
    i: Interval, C: FloatArray, e: FloatArray, s: float, r0_e: FloatArray, C_ne: FloatArray
) -> Deviation:
    """(p, v, theta) after the interval, of the error s e, e (15,), before it."""
    p, v = (s * e[0], s * e[1], s * e[2]), (s * e[3], s * e[4], s * e[5])
    theta, du = turned(
        i,
        C,
        (s * e[6], s * e[7], s * e[8]),
        (-s * e[9], -s * e[10], -s * e[11]),
        (-s * e[12], -s * e[13], -s * e[14]),
    )
    p, v = moved(i, p, v, du, gravity_change(i, p, v, r0_e, C_ne))
    return p, v, theta


@kernel
def deviation_of_place(
    i: Interval, e: FloatArray, s: float, r0_e: FloatArray, C_ne: FloatArray
) -> Deviation:
    """`deviation` of an error of position and velocity alone."""
    p, v = (s * e[0], s * e[1], s * e[2]), (s * e[3], s * e[4], s * e[5])
    zero = (0.0, 0.0, 0.0)
    p, v = moved(i, p, v, zero, gravity_change(i, p, v, r0_e, C_ne))
    return p, v, zero


@kernel
def deviation_of_reading(i: Interval, C: FloatArray, e: FloatArray, s: float) -> Deviation:
    """`deviation` of an error of the readings alone."""
    zero = (0.0, 0.0, 0.0)
    theta, du = turned(
        i, C, zero, (-s * e[9], -s * e[10], -s * e[11]), (-s * e[12], -s * e[13], -s * e[14])
    )
    p, v = moved(i, zero, zero, du, zero)
    return p, v, theta


@kernel
def put_pair(
    M: FloatArray, first: int, second: int, mean: FloatArray, plus: Deviation, minus: Deviation
) -> None:
    """Rows `first` and `second` of M <- the deviations of a pair of sigma points; `mean` takes its share."""
    for block in range(3):
        a, b = plus[block], minus[block]
        for k in range(3):
            c = 3 * block + k
            M[first, c] = FIRST * (a[k] - b[k])
            M[second, c] = SECOND * (a[k] + b[k])
            mean[c] += MEAN * (a[k] + b[k])


@kernel
def put_noises(E: FloatArray, first: int, noise: FloatArray, scale: float, dt: float) -> None:
    """Rows of E from `first` on <- deviations of the readings: white noise, constant over the interval."""
    gyro, accel = scale * noise[0] / math.sqrt(dt), scale * noise[1] / math.sqrt(dt)
    for k in range(3):
        E[first + k, 9 + k] = gyro
        E[first + 3 + k, 12 + k] = accel


@kernel
def walk_noise(noise: FloatArray, k: int, dt: float) -> float:
    """The sigma of what the k-th bias walks in dt."""
    return (noise[2] if k < 3 else noise[3]) * math.sqrt(dt)


@kernel
def propagate_fully(
    S: FloatArray,
    i: Interval,
    noise: FloatArray,
    scale: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    work: Scratch,
) -> None:
    """S over an interval, in place, in the full second-order form; work's mean <- the shift of the mean.

    All states and all noises alike: a pair of sigma points each, both differences, one triangularization.
    """
    C, M, E, mean = work
    n = S.shape[0]
    noises, walks, rows = n, n + NOISES, n + NOISES + BIASES
    for j in range(n):
        for c in range(CORE_SIZE):
            E[j, c] = S[j, c]
    put_noises(E, noises, noise, scale, i.dt)
    for c in range(MOVING):
        mean[c] = 0.0
    for j in range(rows):
        plus = deviation(i, C, E[j], H, r0_e, C_ne)
        minus = deviation(i, C, E[j], -H, r0_e, C_ne)
        put_pair(M, j, rows + j, mean, plus, minus)
        for c in range(MOVING, M.shape[1]):
            M[j, c] = S[j, c] if j < n and c < n else 0.0
            M[rows + j, c] = 0.0
    for k in range(BIASES):
        M[walks + k, MOVING + k] = walk_noise(noise, k, i.dt)
    turn_attitude_deviations(M, 0, 2 * rows, mean[6], mean[7], mean[8])
    triangularize(M, 0, 2 * rows, n - 1, n)
    take_triangle(S, M, 0, n - 1, n)


@kernel
def propagate(
    S: FloatArray,
    i: Interval,
    noise: FloatArray,
    scale: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    work: Scratch,
) -> None:
    """`propagate_fully` by the structure of the problem: the same up to rounding.

    States that stay are a triangle already. The biases' rows become one with their walks, whose remains join the
    deviations of the nine states that move. The accelerometer's noise acts linearly: one point, no second difference.
    """
    C, M, E, mean = work
    n = S.shape[0]
    walks, place = BIASES, 2 * BIASES
    attitude = place + LINEAR
    noises = place + MOVING
    second = noises + NOISES
    constants = second + LINEAR + 3 + (n - LINEAR)
    put_noises(E, 0, noise, scale, i.dt)
    for c in range(MOVING):
        mean[c] = 0.0
    for j in range(LINEAR):
        plus = deviation_of_place(i, S[j], H, r0_e, C_ne)
        minus = deviation_of_place(i, S[j], -H, r0_e, C_ne)
        put_pair(M, place + j, second + j, mean, plus, minus)
    for k in range(3):
        plus = deviation_of_reading(i, C, E[k], H)
        minus = deviation_of_reading(i, C, E[k], -H)
        put_pair(M, noises + k, second + LINEAR + k, mean, plus, minus)
        p, v, theta = deviation_of_reading(i, C, E[3 + k], 1.0)
        for c in range(3):
            M[noises + 3 + k, c] = p[c]
            M[noises + 3 + k, 3 + c] = v[c]
            M[noises + 3 + k, 6 + c] = theta[c]
    for j in range(LINEAR, n):
        if j < MOVING:
            row = place + j
        elif j < CORE_SIZE:
            row = CORE_SIZE - 1 - j
        else:
            row = constants + j - CORE_SIZE
        plus = deviation(i, C, S[j], H, r0_e, C_ne)
        minus = deviation(i, C, S[j], -H, r0_e, C_ne)
        put_pair(M, row, second + 3 + j, mean, plus, minus)
        for c in range(MOVING, n):
            M[row, c] = S[j, c]
    for k in range(BIASES):
        for c in range(M.shape[1]):
            M[walks + k, c] = 0.0
        M[walks + k, MOVING + k] = walk_noise(noise, k, i.dt)
    turn_attitude_deviations(M, 0, constants + n - CORE_SIZE, mean[6], mean[7], mean[8])
    triangularize(M, 0, place, CORE_SIZE - 1, BIASES)
    triangularize(M, walks, constants, MOVING - 1, MOVING)
    take_triangle(S, M, 0, CORE_SIZE - 1, BIASES)
    take_triangle(S, M, walks, MOVING - 1, MOVING)
    for j in range(CORE_SIZE, n):
        for c in range(MOVING):
            S[j, c] = M[constants + j - CORE_SIZE, c]


# ---- the walk ----------------------------------------------------------------------------------------------------


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
    C, _, _, mean = work
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
        i = interval(w0, f0, w1, f1, phi, dv, dt, middle, g, w_ie_n)
        if full:
            propagate_fully(S, i, noise, scale, r0_e, C_ne, work)
        else:
            propagate(S, i, noise, scale, r0_e, C_ne, work)
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


# ---- the update --------------------------------------------------------------------------------------------------


@kernel
def sigma_points(x: FloatArray, S: FloatArray, columns: IntArray) -> FloatArray:
    """The nominal states (2 n, 20) of x [+] h s_i, then of x [+] -h s_i."""
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
    sigma: FloatArray,
) -> float:
    """Gated update of x, P and S in place; returns the NIS.

    r (m,) is the residual at x, D (2 n, m) how far those of the sigma points are from it; r <- the innovation, which
    the measurement's mean is taken for, sigma (m,) <- its sigmas. One array of deviations over state and measurement
    holds it all: triangular in the measurement's columns it gives the innovation's root and the gain, and what is
    left below is the state's root afterwards.
    """
    n, m = S.shape[0], len(r)
    second, end = m + n, m + 2 * n
    M = np.zeros((end, padded(n + m)))
    L = np.empty((m, m))
    for i in range(m):
        sigma[i] = math.nan
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
            M[m + j, n + i] = FIRST * (D[n + j, i] - D[j, i])
            M[second + j, n + i] = SECOND * (D[n + j, i] + D[j, i])
            r[i] += MEAN * (D[n + j, i] + D[j, i])
    triangularize(M, 0, end, n + m - 1, m)
    y = np.empty(m)
    nis = 0.0
    for k in range(m):
        i = m - 1 - k
        s = r[i]
        for l in range(k):
            s -= y[l] * M[l, n + i]
        y[k] = s / M[k, n + i]
        nis += y[k] * y[k]
    for i in range(m):
        s = 0.0
        for k in range(m - i):
            s += M[k, n + i] * M[k, n + i]
        sigma[i] = math.sqrt(s)
    if not nis <= gate:
        return nis
    d = np.zeros(n)
    for k in range(m):
        for c in range(n):
            d[c] += y[k] * M[k, c]
    turn_attitude_deviations(M, m, end, d[6], d[7], d[8])
    triangularize(M, m, end, n - 1, n)
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
        self._noise = noise.as_array()
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
            self._noise,
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
        D = observation.differences(sigma_points(state.x, state.own, columns), state.u, r)
        for j in self._tau:
            # models do not see the delay in the state: it is the time at which they are asked
            first = H * np.outer(state.own[:, j], J[:, TAU.start])
            D -= np.concatenate([first, -first])
        innovation, sigma = r.copy(), np.empty(len(r))
        nis = fuse(
            state.x, state.P, state.own, innovation, D, observation.R, columns, gate, sigma
        )
        return Outcome(nis, innovation, sigma)
