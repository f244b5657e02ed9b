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

LANES = 4
"""Rows of deviations are padded with zeros to a multiple of this, so that a loop over one has no rest."""


@kernel
def padded(n: int) -> int:
    """The width of rows that hold n values."""
    return LANES * ((n + LANES - 1) // LANES)


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
def triangularize(M: FloatArray, first: int, end: int, last: int, count: int) -> None:
    """Turn the deviations M[first:end] among themselves, in place, until column last - k is zero after row first + k.

    For k < `count`. M has the padded width, with zeros in the columns after `last`; M^T M stays what it is.
    """
    width = padded(last + 1)
    t = np.empty(width)
    for k in range(count):
        row, column = first + k, last - k
        # the products of the column with every other; the one with itself is its squared length
        for j in range(width):
            t[j] = 0.0
        for i in range(row, end):
            a = M[i, column]
            for j in range(width):
                t[j] += a * M[i, j]
        length = math.sqrt(t[column])
        pivot = M[row, column]
        # of the two reflections the one without cancellation
        onto = -length if pivot > 0.0 else length
        scale = t[column] - onto * pivot
        if scale > 0.0:
            for j in range(width):
                t[j] = (t[j] - onto * M[row, j]) / scale
            M[row, column] -= onto
            for i in range(row, end):
                a = M[i, column]
                for j in range(width):
                    M[i, j] -= a * t[j]
            M[row, column] = onto
            for i in range(row + 1, end):
                M[i, column] = 0.0
        width = padded(column)


@kernel
def take_triangle(S: FloatArray, M: FloatArray, first: int, last: int, count: int) -> None:
    """Rows last, last - 1, .. of S <- the `count` rows of M from `first` on, with a positive diagonal."""
    for k in range(count):
        row = last - k
        sign = -1.0 if M[first + k, row] < 0.0 else 1.0
        for j in range(row + 1):
            S[row, j] = sign * M[first + k, j]


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
