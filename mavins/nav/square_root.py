"""Covariances by square roots: P = S^T S with S lower triangular, whose rows are deviations of one sigma each.

Deviations of any number become a triangle again by orthogonal transformations alone (Householder), so P is never
formed on the way, is positive definite by construction, and has twice the digits. A triangle is eliminated from its
last column on: a state's deviation then reaches the states before it, and those at the end, which do not move, need
no work. Sources: Golub and Van Loan (2013), sections 4.2 and 5.2; Kailath, Sayed and Hassibi (2000), chapter 12.
Theory: docs/theory/srcdkf.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray

WIDTH = 32
"""The places in a row of deviations: enough for 23 states and a measurement of 9."""
ROWS = 8
R1, R2, R3, R4, R5, R6, R7 = (k * WIDTH for k in range(1, ROWS))
"""Deviations are taken so many rows at a time; where the rows begin."""
LANES = 4
"""Loops over columns go on to a multiple of this: they have no rest then."""


@kernel
def root_of(S: FloatArray, P: FloatArray) -> bool:
    """S <- the lower triangle with S^T S = P (n, n) and a positive diagonal; False where P is not positive definite."""
    n = P.shape[0]
    for k in range(n - 1, -1, -1):
        s = P[k, k]
        for i in range(k + 1, n):
            s -= S[i, k] * S[i, k]
        if not (s > 0.0 and s < np.inf):
            return False
        S[k, k] = math.sqrt(s)
        for j in range(k):
            s = P[k, j]
            for i in range(k + 1, n):
                s -= S[i, k] * S[i, j]
            S[k, j] = s / S[k, k]
            S[j, k] = 0.0
    return True


@kernel
def square_of(P: FloatArray, S: FloatArray) -> None:
    """P <- S^T S, exactly symmetric."""
    n = S.shape[0]
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = 0.0
        for k in range(i, n):
            s = S[k, i]
            for j in range(i + 1):
                P[i, j] += s * S[k, j]
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]


@kernel
def deviations(count: int) -> FloatArray:
    """An array for `count` deviations: rows of zeros, and some more below, which `triangularize` runs into."""
    return np.zeros((count + ROWS, WIDTH))


@kernel
def triangularize(
    M: FloatArray, first: int, end: int, last: int, count: int, t: FloatArray
) -> None:
    """Turn the deviations M[first:end] among themselves, in place, until column last - k is zero after row first + k.

    For k < `count`. M is an array of `deviations`, zero in the columns after `last`, and in those to be eliminated
    also in the rows from `end` on; M^T M stays what it is. t (WIDTH,) is scratch.
    """
    # flat, eight rows at a time, at distances the compiler knows: only then does it work on several columns at once
    m = M.reshape(-1)
    width = LANES * ((last + LANES) // LANES)
    for k in range(count):
        row, column = first + k, last - k
        # the products of the column with every other; the one with itself is its squared length
        for j in range(width):
            t[j] = 0.0
        for i in range(row, end, ROWS):
            b = m[i * WIDTH :]
            c0, c1, c2, c3 = b[column], b[R1 + column], b[R2 + column], b[R3 + column]
            c4, c5, c6, c7 = b[R4 + column], b[R5 + column], b[R6 + column], b[R7 + column]
            for j in range(width):
                t[j] += ((c0 * b[j] + c1 * b[R1 + j]) + (c2 * b[R2 + j] + c3 * b[R3 + j])) + (
                    (c4 * b[R4 + j] + c5 * b[R5 + j]) + (c6 * b[R6 + j] + c7 * b[R7 + j])
                )
        length = math.sqrt(t[column])
        pivot = M[row, column]
        # of the two reflections the one without cancellation
        onto = -length if pivot > 0.0 else length
        scale = t[column] - onto * pivot
        if scale > 0.0:
            inverse = 1.0 / scale
            for j in range(width):
                t[j] = inverse * (t[j] - onto * M[row, j])
            M[row, column] -= onto
            for i in range(row, end, ROWS):
                b = m[i * WIDTH :]
                c0, c1, c2, c3 = b[column], b[R1 + column], b[R2 + column], b[R3 + column]
                c4, c5, c6, c7 = b[R4 + column], b[R5 + column], b[R6 + column], b[R7 + column]
                for j in range(width):
                    s = t[j]
                    b[j] -= c0 * s
                    b[R1 + j] -= c1 * s
                    b[R2 + j] -= c2 * s
                    b[R3 + j] -= c3 * s
                    b[R4 + j] -= c4 * s
                    b[R5 + j] -= c5 * s
                    b[R6 + j] -= c6 * s
                    b[R7 + j] -= c7 * s
            for i in range(row, end):
                M[i, column] = 0.0
            M[row, column] = onto
        width = LANES * ((column + LANES - 1) // LANES)


@kernel
def take_triangle(S: FloatArray, M: FloatArray, first: int, last: int, count: int) -> None:
    """Rows last, last - 1, .. of S <- the `count` rows of M from `first` on, with a positive diagonal."""
    for k in range(count):
        row = last - k
        sign = -1.0 if M[first + k, row] < 0.0 else 1.0
        for j in range(row + 1):
            S[row, j] = sign * M[first + k, j]


@kernel
def add_deviation(S: FloatArray, k: int, sigma: float, t: FloatArray) -> None:
    """S <- the root of S^T S with sigma^2 more on its k-th diagonal place, by k + 1 plane rotations.

    t (n,) is scratch: the one row more, which the rows of S take up from the k-th to the first.
    """
    if sigma == 0.0:
        return
    for j in range(k):
        t[j] = 0.0
    t[k] = sigma
    for back in range(k + 1):
        row = k - back
        length = math.sqrt(S[row, row] * S[row, row] + t[row] * t[row])
        c, s = S[row, row] / length, t[row] / length
        for j in range(row + 1):
            a, b = S[row, j], t[j]
            S[row, j] = c * a + s * b
            t[j] = c * b - s * a


@kernel
def turn_attitude_deviations(
    M: FloatArray, first: int, end: int, t0: float, t1: float, t2: float
) -> None:
    """Attitude columns of the deviations M[first:end] <- Jr(t) of them: t has gone into q (see linalg)."""
    a0, a1, a2 = 0.5 * t0, 0.5 * t1, 0.5 * t2
    for i in range(first, end):
        m0, m1, m2 = M[i, 6], M[i, 7], M[i, 8]
        M[i, 6] = m0 + a2 * m1 - a1 * m2
        M[i, 7] = m1 - a2 * m0 + a0 * m2
        M[i, 8] = m2 + a1 * m0 - a0 * m1
