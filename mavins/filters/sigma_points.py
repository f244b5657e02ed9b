"""The sigma points of an interval: what becomes of a square root S, P = S^T S, as the state moves.

Along each row s_i of S, and each noise, lie two points; their images' deviations are a pair of new rows:

    d_i+- = f(x [+] (+- h s_i)) [-] f(x),   a_i = (d_i+ - d_i-) / 2h,   b_i = sqrt(h^2 - 1) / 2h^2 (d_i+ + d_i-)
    mean <- sum (d_i+ + d_i-) / 2h^2,   S^T S <- sum a_i a_i^T + b_i b_i^T

Sources: Norgaard, Poulsen and Ravn (2000); van der Merwe (2004), chapter 3. Theory: docs/theory/srcdkf.md.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from mavins.nav.deviations import (
    DT,
    GRAVITY,
    INTERVAL,
    MIDDLE,
    moved,
    pushed,
    turned,
)
from mavins.nav.earth import replace_by_gravity
from mavins.nav.ins import CORE_SIZE, MOVING, Vector
from mavins.nav.kernels import kernel
from mavins.nav.square_root import (
    ROWS,
    WIDTH,
    deviations,
    take_triangle,
    triangularize,
    turn_attitude_deviations,
)
from mavins.types import FloatArray

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


@kernel
def part(g: FloatArray, centre: float) -> None:
    """Values (2 n,) of points and of their opposites <- odd and even parts of how they differ from the centre's."""
    n = len(g) // 2
    for j in range(n):
        plus, minus = g[j] - centre, g[n + j] - centre
        g[j], g[n + j] = 0.5 * (plus - minus), 0.5 * (plus + minus)


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
    part(a, i[GRAVITY])
    part(b, i[GRAVITY + 1])
    part(c, i[GRAVITY + 2])


@kernel
def put_block(M: FloatArray, first: int, second: int, c: int, odd: Vector, even: Vector) -> None:
    """Columns c to c + 2 of the rows `first` and `second` of M <- deviations."""
    M[first, c], M[first, c + 1], M[first, c + 2] = FIRST * odd[0], FIRST * odd[1], FIRST * odd[2]
    M[second, c] = SECOND * even[0]
    M[second, c + 1] = SECOND * even[1]
    M[second, c + 2] = SECOND * even[2]


@kernel
def put_moved(
    M: FloatArray,
    first: int,
    second: int,
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
    put_block(M, first, second, 0, odd_p, even_p)
    put_block(M, first, second, 3, odd_v, even_v)


@kernel
def put_pair(
    M: FloatArray,
    first: int,
    second: int,
    i: FloatArray,
    e: FloatArray,
    j: int,
    dg: tuple[Vector, Vector],
) -> None:
    """Rows `first` and `second` of M <- the deviations of the sigma points +- h e[j], gravity differing by `dg`."""
    theta = (H * e[j, 6], H * e[j, 7], H * e[j, 8])
    w = (-H * e[j, 9], -H * e[j, 10], -H * e[j, 11])
    f = (-H * e[j, 12], -H * e[j, 13], -H * e[j, 14])
    put_moved(M, first, second, i, e, j, pushed(i, theta, w, f), dg)
    odd, even = turned(i, theta, w)
    put_block(M, first, second, 6, odd, even)


@kernel
def add_mean(mean: FloatArray, M: FloatArray, first: int, end: int) -> None:
    """Add the share of the second differences M[first:end] to the mean's shift."""
    for j in range(first, end):
        for c in range(MOVING):
            mean[c] += MEAN / SECOND * M[j, c]


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
    density: float = noise[2] if k < 3 else noise[3]
    return density * math.sqrt(dt)


@kernel
def propagate_fully(
    S: FloatArray,
    noise: FloatArray,
    scale: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    work: Scratch,
) -> None:
    """S over an interval, in place, in the full second-order form; work's mean <- the shift of the mean.

    All states and all noises alike: a pair of sigma points each, both differences, one triangularization.
    """
    M, t, E, mean, a, b, c, i = work[1:]
    n = S.shape[0]
    walks, rows = n + NOISES, n + NOISES + BIASES
    gravities(S, i, r0_e, C_ne, a, b, c)
    put_noises(E, n, noise, scale, i[DT])
    for k in range(MOVING):
        mean[k] = 0.0
    for j in range(rows):
        if j < n:
            dg = ((a[j], b[j], c[j]), (a[n + j], b[n + j], c[n + j]))
            put_pair(M, j, rows + j, i, S, j, dg)
        else:
            put_pair(M, j, rows + j, i, E, j, (NONE, NONE))
        for k in range(MOVING, n):
            M[j, k] = S[j, k] if j < n else 0.0
            M[rows + j, k] = 0.0
    for k in range(BIASES):
        M[walks + k, MOVING + k] = walk_noise(noise, k, i[DT])
    add_mean(mean, M, rows, 2 * rows)
    turn_attitude_deviations(M, 0, 2 * rows, mean[6], mean[7], mean[8])
    triangularize(M, 0, 2 * rows, n - 1, n, t)
    take_triangle(S, M, 0, n - 1, n)


@kernel
def propagate(
    S: FloatArray,
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
    M, t, E, mean, a, b, c, i = work[1:]
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
        put_moved(M, place + j, falling + j, i, S, j, (NONE, NONE), dg)
    for j in range(LINEAR, n):
        if j < MOVING:
            row = attitude + j - LINEAR
        elif j < CORE_SIZE:
            row = CORE_SIZE - 1 - j
        else:
            row = constants + j - CORE_SIZE
        dg = ((a[j], b[j], c[j]), (a[n + j], b[n + j], c[n + j]))
        put_pair(M, row, turning + j, i, S, j, dg)
        if j >= MOVING:
            for k in range(MOVING, CORE_SIZE):
                M[row, k] = S[j, k]
    for k in range(3):
        put_pair(M, gyro + k, gyro_turning + k, i, E, k, (NONE, NONE))
        # linear: the second difference is zero, and overwritten
        put_moved(
            M,
            accel + k,
            walks + k,
            i,
            E,
            3 + k,
            pushed(i, NONE, NONE, (H * E[3 + k, 12], H * E[3 + k, 13], H * E[3 + k, 14])),
            (NONE, NONE),
        )
    for k in range(BIASES):
        for j in range(CORE_SIZE):
            M[walks + k, j] = 0.0
        M[walks + k, MOVING + k] = walk_noise(noise, k, i[DT])
    add_mean(mean, M, turning + LINEAR, place)
    add_mean(mean, M, falling, falling + LINEAR)
    turn_attitude_deviations(M, 0, end, mean[6], mean[7], mean[8])
    triangularize(M, 0, attitude, CORE_SIZE - 1, BIASES, t)
    triangularize(M, walks, place, MOVING - 1, 3, t)
    triangularize(M, walks + 3, falling + LINEAR, LINEAR - 1, LINEAR, t)
    take_triangle(S, M, 0, CORE_SIZE - 1, BIASES)
    take_triangle(S, M, walks, MOVING - 1, MOVING)
    for j in range(CORE_SIZE, n):
        for k in range(MOVING):
            S[j, k] = M[constants + j - CORE_SIZE, k]
