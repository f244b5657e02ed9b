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
from mavins.nav.deviations import (
    DT,
    GRAVITY,
    INTERVAL,
    MIDDLE,
    moved,
    pushed,
    turned,
    write_interval,
)
from mavins.nav.earth import TangentFrame, replace_by_gravity
from mavins.nav.ins import CORE_SIZE, MOVING, Vector, increments_from_rates, mechanize
from mavins.nav.kernels import kernel
from mavins.nav.layout import TAU, Layout, boxplus
from mavins.nav.linalg import cholesky
from mavins.nav.square_root import (
    ROWS,
    WIDTH,
    deviations,
    root_of,
    square_of,
    take_triangle,
    triangularize,
    turn_attitude_deviations,
)
from mavins.types import FloatArray, IntArray

H = math.sqrt(3.0)
"""The distance of the sigma points, in sigmas: the fourth moments of a normal distribution are right with it."""
FIRST = 1.0 / H
SECOND = math.sqrt(H * H - 1.0) / (H * H)
MEAN = 1.0 / (H * H)
"""What the odd and even parts (d+ -+ d-) / 2 are multiplied by in the deviations, and the even ones in the mean."""
LINEAR = 6
"""Errors of position and velocity are added: of their sigma points only gravity is not linear."""
BIASES = CORE_SIZE - MOVING
NOISES = 6
"""White noises of gyro and accelerometer, which are errors of the readings over an interval as the biases are."""
NONE = (0.0, 0.0, 0.0)

Scratch: TypeAlias = tuple[
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
]


@kernel
def scratch(n: int) -> Scratch:
    """Arrays for n states.

    (C, M, t, E, mean, g0, g1, g2, i): C_nb, the deviations after an interval, a row of them, those of the readings,
    the mean's shift, gravities, the interval.
    """
    rows = n + NOISES + BIASES
    return (
        np.empty((3, 3)),
        deviations(2 * rows),
        np.zeros(WIDTH),
        np.zeros((rows, CORE_SIZE)),
        np.zeros(n),
        np.zeros(2 * n),
        np.zeros(2 * n),
        np.zeros(2 * n),
        np.zeros(INTERVAL),
    )


# ---- the sigma points of an interval -----------------------------------------------------------------------------


@kernel
def gravities(
    S: FloatArray,
    i: FloatArray,
    r0_e: FloatArray,
    C_ne: FloatArray,
    a: FloatArray,
    b: FloatArray,
    c: FloatArray,
) -> None:
    """(a, b, c), each (2 n,), <- how gravity at mid-interval differs: the odd parts of h s_i, then the even ones."""
    n, h = S.shape[0], 0.5 * i[DT]
    for j in range(n):
        d0 = H * (S[j, 0] + h * S[j, 3])
        d1 = H * (S[j, 1] + h * S[j, 4])
        d2 = H * (S[j, 2] + h * S[j, 5])
        a[j], b[j], c[j] = i[MIDDLE] + d0, i[MIDDLE + 1] + d1, i[MIDDLE + 2] + d2
        a[n + j], b[n + j], c[n + j] = i[MIDDLE] - d0, i[MIDDLE + 1] - d1, i[MIDDLE + 2] - d2
    replace_by_gravity(a, b, c, r0_e, C_ne)
    for k, g in ((GRAVITY, a), (GRAVITY + 1, b), (GRAVITY + 2, c)):
        for j in range(n):
            plus, minus = g[j] - i[k], g[n + j] - i[k]
            g[j], g[n + j] = 0.5 * (plus - minus), 0.5 * (plus + minus)


@kernel
def put_block(
    M: FloatArray, first: int, second: int, mean: FloatArray, c: int, odd: Vector, even: Vector
) -> None:
    """Columns c to c + 2 of the rows `first` and `second` of M <- deviations; `mean` takes its share."""
    for k in range(3):
        M[first, c + k] = FIRST * odd[k]
        M[second, c + k] = SECOND * even[k]
        mean[c + k] += MEAN * even[k]


@kernel
def put_moved(
    M: FloatArray,
    first: int,
    second: int,
    mean: FloatArray,
    i: FloatArray,
    e: FloatArray,
    j: int,
    du: tuple[Vector, Vector],
    dg: tuple[Vector, Vector],
) -> None:
    """Position and velocity of the sigma points +- h e[j] after the interval, e (k, 15)."""
    p = (H * e[j, 0], H * e[j, 1], H * e[j, 2])
    v = (H * e[j, 3], H * e[j, 4], H * e[j, 5])
    odd_p, odd_v = moved(i, p, v, du[0], dg[0])
    even_p, even_v = moved(i, NONE, NONE, du[1], dg[1])
    put_block(M, first, second, mean, 0, odd_p, even_p)
    put_block(M, first, second, mean, 3, odd_v, even_v)


@kernel
def put_pair(
    M: FloatArray,
    first: int,
    second: int,
    mean: FloatArray,
    i: FloatArray,
    C: FloatArray,
    e: FloatArray,
    j: int,
    dg: tuple[Vector, Vector],
) -> None:
    """Rows `first` and `second` of M <- the deviations of the sigma points +- h e[j], gravity differing by `dg`."""
    theta = (H * e[j, 6], H * e[j, 7], H * e[j, 8])
    w = (-H * e[j, 9], -H * e[j, 10], -H * e[j, 11])
    f = (-H * e[j, 12], -H * e[j, 13], -H * e[j, 14])
    put_moved(M, first, second, mean, i, e, j, pushed(i, C, theta, w, f), dg)
    odd, even = turned(i, theta, w)
    put_block(M, first, second, mean, 6, odd, even)


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
    i: FloatArray,
    noise: FloatArray,
    scale: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    work: Scratch,
) -> None:
    """S over an interval, in place, in the full second-order form; work's mean <- the shift of the mean.

    All states and all noises alike: a pair of sigma points each, both differences, one triangularization.
    """
    C, M, t, E, mean, a, b, c, _ = work
    n = S.shape[0]
    walks, rows = n + NOISES, n + NOISES + BIASES
    gravities(S, i, r0_e, C_ne, a, b, c)
    put_noises(E, n, noise, scale, i[DT])
    for k in range(MOVING):
        mean[k] = 0.0
    for j in range(rows):
        if j < n:
            dg = ((a[j], b[j], c[j]), (a[n + j], b[n + j], c[n + j]))
            put_pair(M, j, rows + j, mean, i, C, S, j, dg)
        else:
            put_pair(M, j, rows + j, mean, i, C, E, j, (NONE, NONE))
        for k in range(MOVING, n):
            M[j, k] = S[j, k] if j < n else 0.0
            M[rows + j, k] = 0.0
    for k in range(BIASES):
        M[walks + k, MOVING + k] = walk_noise(noise, k, i[DT])
    turn_attitude_deviations(M, 0, 2 * rows, mean[6], mean[7], mean[8])
    triangularize(M, 0, 2 * rows, n - 1, n, t)
    take_triangle(S, M, 0, n - 1, n)


@kernel
def propagate(
    S: FloatArray,
    i: FloatArray,
    noise: FloatArray,
    scale: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    work: Scratch,
) -> None:
    """`propagate_fully` by the structure of the problem: the same up to rounding.

    States that stay are a triangle already. The biases' rows become one with their walks, whose remains join the
    deviations of the nine states that move, first those that turn. The accelerometer's noise acts linearly: one point,
    no second difference.
    """
    C, M, t, E, mean, a, b, c, _ = work
    n = S.shape[0]
    # where rows of M begin: biases, their walks, then what has a share in the attitude, what has none, and constants
    walks = BIASES
    attitude = walks + BIASES
    gyro = attitude + 3
    turning = gyro + 3 - LINEAR
    gyro_turning = turning + n
    place = gyro_turning + 3
    accel = place + LINEAR
    falling = accel + 3
    constants = falling + LINEAR + ROWS
    end = constants + n - CORE_SIZE
    gravities(S, i, r0_e, C_ne, a, b, c)
    put_noises(E, 0, noise, scale, i[DT])
    for k in range(MOVING):
        mean[k] = 0.0
    for j in range(LINEAR):
        dg = ((a[j], b[j], c[j]), (a[n + j], b[n + j], c[n + j]))
        put_moved(M, place + j, falling + j, mean, i, S, j, (NONE, NONE), dg)
    for j in range(LINEAR, n):
        if j < MOVING:
            row = attitude + j - LINEAR
        elif j < CORE_SIZE:
            row = CORE_SIZE - 1 - j
        else:
            row = constants + j - CORE_SIZE
        dg = ((a[j], b[j], c[j]), (a[n + j], b[n + j], c[n + j]))
        put_pair(M, row, turning + j, mean, i, C, S, j, dg)
        if j >= MOVING:
            for k in range(MOVING, CORE_SIZE):
                M[row, k] = S[j, k]
    for k in range(3):
        put_pair(M, gyro + k, gyro_turning + k, mean, i, C, E, k, (NONE, NONE))
        # linear: the second difference is zero, and overwritten
        put_moved(
            M,
            accel + k,
            walks + k,
            mean,
            i,
            E,
            3 + k,
            pushed(i, C, NONE, NONE, (H * E[3 + k, 12], H * E[3 + k, 13], H * E[3 + k, 14])),
            (NONE, NONE),
        )
    for k in range(BIASES):
        for j in range(CORE_SIZE):
            M[walks + k, j] = 0.0
        M[walks + k, MOVING + k] = walk_noise(noise, k, i[DT])
    turn_attitude_deviations(M, 0, end, mean[6], mean[7], mean[8])
    triangularize(M, 0, attitude, CORE_SIZE - 1, BIASES, t)
    triangularize(M, walks, place, MOVING - 1, 3, t)
    triangularize(M, walks + 3, falling + LINEAR, LINEAR - 1, LINEAR, t)
    take_triangle(S, M, 0, CORE_SIZE - 1, BIASES)
    take_triangle(S, M, walks, MOVING - 1, MOVING)
    for j in range(CORE_SIZE, n):
        for k in range(MOVING):
            S[j, k] = M[constants + j - CORE_SIZE, k]


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
        write_interval(i, w0, f0, w1, f1, phi, dv, dt, middle, g, w_ie_n)
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
    M, t = deviations(end), np.empty(WIDTH)
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
        nis = fuse(state.x, state.P, state.own, innovation, D, observation.R, columns, gate, sigma)
        return Outcome(nis, innovation, sigma)
