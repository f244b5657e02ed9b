"""Linear algebra of the measurement update: whitening, sequential Joseph updates, the chi-square gate.

Rows are whitened by the Cholesky factor of R and then taken one at a time. The sum of the normalized squares
of the sequential innovations is the joint NIS r^T S^-1 r, so the gate is joint although no S is inverted.
Sources: Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977), chapters II and V; Bucy and
Joseph (1968) for the update's form. Theory: docs/theory/update.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray, IntArray


@kernel
def whiten(r: FloatArray, H: FloatArray, R: FloatArray) -> bool:
    """r <- L^-1 r, H <- L^-1 H in place with L L^T = R (m, m); False where R is not positive definite."""
    m, n = H.shape
    L = np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            s = R[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not (s > 0.0 and s < np.inf):
                    return False
                L[i, i] = math.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(m):
        for k in range(i):
            r[i] -= L[i, k] * r[k]
            for c in range(n):
                H[i, c] -= L[i, k] * H[k, c]
        r[i] /= L[i, i]
        for c in range(n):
            H[i, c] /= L[i, i]
    return True


@kernel
def scalar_update(P: FloatArray, d: FloatArray, r: float, h: FloatArray, work: FloatArray) -> float:
    """One row with unit noise: P <- (I - k h) P (I - k h)^T + k k^T, d <- d + k (r - h d), both in place.

    P (n, n), d (n,), h (n,), `work` (2, n) is scratch. Returns the row's normalized innovation squared, or nan where
    s = h P h^T + 1 is not a positive number, in which case nothing is changed. P stays symmetric to rounding; the
    caller makes it exactly so after its last row.
    """
    n = P.shape[0]
    w, k = work[0], work[1]
    for i in range(n):
        w[i] = 0.0
    for j in range(n):
        c = h[j]
        if c != 0.0:
            for i in range(n):
                w[i] += P[j, i] * c
    hw = 0.0
    innovation = r
    for i in range(n):
        hw += h[i] * w[i]
        innovation -= h[i] * d[i]
    s = hw + 1.0
    if not (s >= 1.0 and s < np.inf and math.fabs(innovation) < np.inf):
        return math.nan
    for i in range(n):
        k[i] = w[i] / s
    # A = P - k w^T, then A - (A h) k^T + k k^T with A h = w - k hw
    for i in range(n):
        k_i = k[i]
        b_i = w[i] - k_i * hw - k_i
        for j in range(n):
            P[i, j] -= k_i * w[j] + b_i * k[j]
        d[i] += k_i * innovation
    return innovation * innovation / s


@kernel
def gated_update(
    P: FloatArray,
    r: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    d: FloatArray,
) -> float:
    """Update P (n, n) with m rows if their joint NIS is at most `gate`; returns the NIS, d (n,) <- the correction.

    r (m,) is the residual z - h(x), H (m, 19) its Jacobian over the canonical errors, of which the layout's
    `columns` are taken, R (m, m) the noise covariance. A NIS above the gate, or nan where R, S or the updated P is not
    positive definite, means that P was left as it was and d must not be used.
    """
    m, n = len(r), P.shape[0]
    rows = np.empty((m, n))
    res = np.empty(m)
    updated = np.empty((n, n))
    work = np.empty((2, n))
    for i in range(m):
        res[i] = r[i]
        for j in range(n):
            rows[i, j] = H[i, columns[j]]
    if not whiten(res, rows, R):
        return math.nan
    for i in range(n):
        d[i] = 0.0
        for j in range(n):
            updated[i, j] = P[i, j]
    nis = 0.0
    for i in range(m):
        nis += scalar_update(updated, d, res[i], rows[i], work)
    if not nis <= gate:
        return nis
    for i in range(n):
        if not (updated[i, i] > 0.0 and math.fabs(d[i]) < np.inf):
            return math.nan
    for i in range(n):
        P[i, i] = updated[i, i]
        for j in range(i):
            mean = 0.5 * (updated[i, j] + updated[j, i])
            P[i, j] = mean
            P[j, i] = mean
    return nis


@kernel
def innovation_sigma(
    P: FloatArray, H: FloatArray, R: FloatArray, columns: IntArray, sigma: FloatArray
) -> None:
    """Sigma (m,) <- sqrt(diag(H P H^T + R)), what the residuals of H (m, 19) should look like; shapes as above."""
    n = P.shape[0]
    for i in range(H.shape[0]):
        s = R[i, i]
        for a in range(n):
            if H[i, columns[a]] != 0.0:
                for b in range(n):
                    s += H[i, columns[a]] * P[a, b] * H[i, columns[b]]
        sigma[i] = math.sqrt(s) if s > 0.0 else math.nan


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
    for c in range(n):
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
