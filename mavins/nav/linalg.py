"""Linear algebra of the measurement update: Cholesky gain, Joseph form, chi-square gate.

The NIS comes out of the Cholesky factor of S before anything is changed, so the gate is joint over the rows and what it
refuses leaves no trace. Sources: Groves (2013), section 3.2; Bucy and Joseph (1968) for the update's form; Golub and
Van Loan (2013), section 4.2. Theory: docs/theory/update.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray, IntArray

LANES = 8
"""Rows of scratch arrays are padded with zeros to a multiple of this, so that a loop over one has no rest."""


@kernel
def cholesky(L: FloatArray, S: FloatArray) -> bool:
    """L <- the lower triangle of L L^T = S (m, m), its diagonal inverted; False where S is not positive definite."""
    m = L.shape[0]
    for i in range(m):
        for j in range(i):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s * L[j, j]
        s = S[i, i]
        for k in range(i):
            s -= L[i, k] * L[i, k]
        if not (s > 0.0 and s < np.inf):
            return False
        L[i, i] = 1.0 / math.sqrt(s)
    return True


@kernel
def gated_update(
    P: FloatArray,
    r: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    d: FloatArray,
    S: FloatArray,
) -> float:
    """Update P (n, n) with m rows if their NIS is at most `gate`; returns the NIS, d (n,) <- the correction K r.

    r (m,) is the residual z - h(x), H (m, 25) its Jacobian over the canonical errors, of which the layout's
    `columns` are taken, R (m, m) the noise covariance; S (m, m) <- the residuals' covariance.
    A NIS above the gate, or nan where R, S or the updated P is not positive definite, means that P was left as it was
    and d must not be used.

        W = P H^T,  S = H W + R = L L^T,  y = L^-1 r,  NIS = y^T y,  K = W S^-1
        P <- (I - K H) P (I - K H)^T + K R K^T = P - K W^T - (W - K S) K^T
    """
    m, n = len(r), P.shape[0]
    p = LANES * ((n + LANES - 1) // LANES)
    # one array and views of it: a small allocation costs as much as a matrix product here
    rows = np.zeros((3 * m + n, p))
    W, K, B, A = rows[:m], rows[m : 2 * m], rows[2 * m : 3 * m], rows[3 * m :]
    small = np.empty((m + 1, m))
    L, y = small[:m], small[m]
    for j in range(n):
        for a in range(n):
            A[j, a] = P[j, a]
    # all but A are transposed; K holds the rows of H until they are no longer needed
    for j in range(n):
        column = columns[j]
        for i in range(m):
            h = H[i, column]
            if h != 0.0:
                K[i, j] = h
                for a in range(p):
                    W[i, a] += h * A[j, a]
    for i in range(m):
        for k in range(i + 1):
            s = R[i, k]
            for j in range(n):
                s += K[i, j] * W[k, j]
            S[i, k] = s
            S[k, i] = s
    if not (cholesky(L, R) and cholesky(L, S)):
        return math.nan
    nis = 0.0
    for i in range(m):
        s = r[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s * L[i, i]
        nis += y[i] * y[i]
    if not nis <= gate:
        return nis
    # K^T = L^-T L^-1 W^T: forwards over the rows, then backwards
    for i in range(m):
        c = L[i, i]
        for a in range(p):
            K[i, a] = c * W[i, a]
        for k in range(i):
            e = c * L[i, k]
            for a in range(p):
                K[i, a] -= e * K[k, a]
    for back in range(m):
        i = m - 1 - back
        c = L[i, i]
        for a in range(p):
            K[i, a] *= c
        for k in range(i + 1, m):
            e = c * L[k, i]
            for a in range(p):
                K[i, a] -= e * K[k, a]
    for a in range(n):
        d[a] = 0.0
    for i in range(m):
        c = r[i]
        for a in range(n):
            d[a] += c * K[i, a]
        # nothing but the rounding of K: what makes the update Joseph's
        for a in range(p):
            B[i, a] = W[i, a]
        for k in range(m):
            c = S[i, k]
            for a in range(p):
                B[i, a] -= c * K[k, a]
    for i in range(m):
        for j in range(n):
            k_j, b_j = K[i, j], B[i, j]
            for a in range(p):
                A[j, a] -= k_j * W[i, a] + b_j * K[i, a]
    for a in range(n):
        if not (A[a, a] > 0.0 and math.fabs(d[a]) < np.inf):
            return math.nan
    for j in range(n):
        for a in range(j + 1):
            P[j, a] = A[j, a]
            P[a, j] = A[j, a]
    return nis


@kernel
def reset_attitude_error(P: FloatArray, theta: FloatArray) -> None:
    """P <- G P G^T in place with G = Jr(theta) on the attitude block, once theta has gone into q (Sola eq. 287)."""
    n = P.shape[0]
    a0, a1, a2 = 0.5 * theta[0], 0.5 * theta[1], 0.5 * theta[2]
    for c in range(n):
        t0, t1, t2 = P[6, c], P[7, c], P[8, c]
        P[6, c] = t0 + a2 * t1 - a1 * t2
        P[7, c] = t1 - a2 * t0 + a0 * t2
        P[8, c] = t2 + a1 * t0 - a0 * t1
    for c in range(6, 9):
        t0, t1, t2 = P[c, 6], P[c, 7], P[c, 8]
        P[c, 6] = t0 + a2 * t1 - a1 * t2
        P[c, 7] = t1 - a2 * t0 + a0 * t2
        P[c, 8] = t2 + a1 * t0 - a0 * t1
    for i in range(6, 9):
        for j in range(n):
            if j < 6 or j > i:
                P[j, i] = P[i, j]


@kernel
def is_sane(x: FloatArray, P: FloatArray) -> bool:
    """True where the nominal state is finite and every variance is a positive finite number."""
    for i in range(len(x)):
        if not math.fabs(x[i]) < np.inf:
            return False
    for i in range(P.shape[0]):  # noqa: SIM110 (numba knows no generator expressions)
        if not (P[i, i] > 0.0 and P[i, i] < np.inf):
            return False
    return True
