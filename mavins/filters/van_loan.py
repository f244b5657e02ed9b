"""Van Loan's discretization of navigation errors whose dynamics are constant over an interval, in closed form.

    p' = v                                 root PSDs of the white noises: on theta gyro, on v accelerometer,
    v' = B theta - C b_a                   on b_g and b_a their walks
    theta' = A theta - b_g
    b_g' = 0,  b_a' = 0

Phi = exp(F h) and Q = int_0^h exp(F s) G exp(F^T s) ds are what Van Loan reads off an exponential of twice the size.
Here everything but A is nilpotent, so both are made of W_k = A-series (3, 3) and integrals of their products:

    W_k(s) = sum_i A^i s^(i+k) / (i+k)!,   W_k' = W_(k-1),   W_k = s^k / k! + A W_(k+1)
    X_jk = int_0^h W_j N W_k^T ds = N M_jk^T + A X_(j+1)k,   M_jk = int_0^h s^j / j! W_k ds

Source: Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23 (1978).
Theory: docs/theory/euler_ekf.md.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np

from mavins.nav.ins import CORE_SIZE, LANES, MOVING
from mavins.nav.kernels import kernel
from mavins.types import FloatArray

Workspace: TypeAlias = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray
]
Noise: TypeAlias = tuple[float, float, float, float]
"""PSDs of the white noises: gyro, accelerometer, and the walks of their biases."""

DEPTH: Final = 8
"""W_k is found for k = 0 .. DEPTH; X_44, from which the X descend, by its first two terms."""
SERIES_END: Final = 1e-12
"""The series of W_DEPTH ends with a term this small beside the first; W_0 feels it by a factor |A h|^8 / 8! less."""
LONGEST_SERIES: Final = 60
TURNED: Final = LANES * ((MOVING + LANES - 1) // LANES)


@kernel
def multiply(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Out <- a b, all (3, 3); `out` is neither."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def multiply_turned(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Out <- a b^T, all (3, 3); `out` is neither."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@kernel
def write_exponential_integrals(W: FloatArray, A: FloatArray, h: float) -> None:
    """W[k] <- W_k(h), k = 0 .. 8, for W (9, 3, 3): W_0 = exp(A h), each further one the integral of the one before."""
    first = 1.0
    for k in range(1, DEPTH + 1):
        first *= h / k
    term, following = W[0], W[1]
    for i in range(3):
        for j in range(3):
            term[i, j] = first if i == j else 0.0
            W[DEPTH, i, j] = term[i, j]
    for n in range(DEPTH + 1, DEPTH + LONGEST_SERIES):
        multiply(following, A, term)
        largest = 0.0
        for i in range(3):
            for j in range(3):
                term[i, j] = h / n * following[i, j]
                W[DEPTH, i, j] += term[i, j]
                largest = max(largest, math.fabs(term[i, j]))
        if largest <= SERIES_END * first:
            break
    c = first
    for k in range(DEPTH - 1, -1, -1):
        c *= (k + 1) / h
        multiply(W[k], A, W[k + 1])
        for i in range(3):
            W[k, i, i] += c


@kernel
def write_moment(m: FloatArray, W: FloatArray, h: float, j: int, k: int) -> None:
    """M <- M_jk (3, 3) by parts: sum over i of (-1)^i h^(j-i) / (j-i)! W_(k+1+i)."""
    c = 1.0
    for i in range(1, j + 1):
        c *= h / i
    for a in range(3):
        for b in range(3):
            m[a, b] = 0.0
    for i in range(j + 1):
        for a in range(3):
            for b in range(3):
                m[a, b] += c * W[k + 1 + i, a, b]
        c *= -(j - i) / h


@kernel
def write_noise_integrals(
    X: FloatArray, W: FloatArray, A: FloatArray, N: FloatArray, h: float, work: Workspace
) -> None:
    """X[j, k] <- X_jk for |j - k| <= 2 up to 4, X (5, 5, 3, 3); N (3, 3) is symmetric."""
    m = work[0][0]
    c = h**9 / 5184.0
    s = h**10 / 28800.0
    multiply(m, A, N)
    for a in range(3):
        for b in range(3):
            X[4, 4, a, b] = c * N[a, b] + s * (m[a, b] + m[b, a])
    for k in range(4, -1, -1):
        for j in range(min(k, 3), max(k - 2, 0) - 1, -1):
            write_moment(m, W, h, j, k)
            multiply_turned(X[j, k], N, m)
            for a in range(3):
                for b in range(3):
                    X[j, k, a, b] += (
                        A[a, 0] * X[j + 1, k, 0, b]
                        + A[a, 1] * X[j + 1, k, 1, b]
                        + A[a, 2] * X[j + 1, k, 2, b]
                    )
            for a in range(3):
                for b in range(3):
                    X[k, j, b, a] = X[j, k, a, b]


@kernel
def write_transition(
    Phi: FloatArray,
    W: FloatArray,
    D: FloatArray,
    C: FloatArray,
    S: FloatArray,
    h: float,
    work: Workspace,
) -> None:
    """Phi (9, 15) <- the rows of p, v and theta of exp(F h), their columns from theta on.

    D (3, 3, 3) is B, B and the matrix that theta is multiplied by after the interval, S the one before it.
    The first six columns hold nothing: p <- p + h v + .., v <- v + .. is known (see apply_transition).
    """
    m = work[0][0]
    for r in range(3):
        multiply(m, D[r], W[2 - r])
        for i in range(3):
            for j in range(3):
                Phi[3 * r + i, 6 + j] = m[i, 0] * S[0, j] + m[i, 1] * S[1, j] + m[i, 2] * S[2, j]
                Phi[3 * r + i, 9 + j] = -(
                    D[r, i, 0] * W[3 - r, 0, j]
                    + D[r, i, 1] * W[3 - r, 1, j]
                    + D[r, i, 2] * W[3 - r, 2, j]
                )
    for i in range(3):
        for j in range(3):
            Phi[i, 12 + j] = -0.5 * h * h * C[i, j]
            Phi[3 + i, 12 + j] = -h * C[i, j]


@kernel
def apply_transition(
    M: FloatArray, Phi: FloatArray, h: float, out: FloatArray, n_p: int, n_v: int, n_t: int
) -> None:
    """Out (9, k) <- the moving rows of Phi M for M (n, k), whose first 15 rows are the core errors.

    Of the rows of p, v and theta only the first n_p, n_v and n_t columns are found.
    """
    for i in range(6):
        t0, t1, t2 = Phi[i, 6], Phi[i, 7], Phi[i, 8]
        g0, g1, g2 = Phi[i, 9], Phi[i, 10], Phi[i, 11]
        a0, a1, a2 = Phi[i, 12], Phi[i, 13], Phi[i, 14]
        step, below, width = (h, i + 3, n_p) if i < 3 else (0.0, i, n_v)
        for c in range(width):
            out[i, c] = (
                (M[i, c] + step * M[below, c])
                + (t0 * M[6, c] + t1 * M[7, c] + t2 * M[8, c])
                + (g0 * M[9, c] + g1 * M[10, c] + g2 * M[11, c])
                + (a0 * M[12, c] + a1 * M[13, c] + a2 * M[14, c])
            )
    for i in range(6, 9):
        t0, t1, t2 = Phi[i, 6], Phi[i, 7], Phi[i, 8]
        g0, g1, g2 = Phi[i, 9], Phi[i, 10], Phi[i, 11]
        for c in range(n_t):
            out[i, c] = (t0 * M[6, c] + t1 * M[7, c] + t2 * M[8, c]) + (
                g0 * M[9, c] + g1 * M[10, c] + g2 * M[11, c]
            )


@kernel
def propagate(P: FloatArray, Phi: FloatArray, h: float, work: Workspace) -> None:
    """P <- Phi P Phi^T, in place and exactly symmetric."""
    n = P.shape[0]
    half, turned, block = work[4], work[5], work[6]
    apply_transition(P, Phi, h, half, n, n, n)
    for c in range(CORE_SIZE):
        for r in range(MOVING):
            turned[c, r] = half[r, c]
    for r in range(MOVING):
        for c in range(MOVING, n):
            P[r, c] = half[r, c]
    for c in range(MOVING, n):
        for r in range(MOVING):
            P[c, r] = half[r, c]
    # widths from an array, not constants: those would be unrolled into scalar code
    third = turned.shape[1] // 3
    apply_transition(turned, Phi, h, block, third, 2 * third, 3 * third)
    for r in range(MOVING):
        for c in range(r + 1):
            P[r, c] = block[r, c]
            P[c, r] = block[r, c]


@kernel
def add_noise(
    P: FloatArray,
    X: FloatArray,
    W: FloatArray,
    D: FloatArray,
    C: FloatArray,
    h: float,
    noise: Noise,
    work: Workspace,
) -> None:
    """P <- P + Q, exactly symmetric, for the PSDs `noise` of gyro, accelerometer and of the walks of their biases.

    The gyro's is that times the N of X; the gyro bias's needs N = I. D as in `write_transition`, with C^T C = I.
    """
    Y, DY = work[0][0], work[0][1]
    q_g, q_a, q_bg, q_ba = noise
    for r in range(3):
        for s in range(r + 1):
            for i in range(3):
                for j in range(3):
                    Y[i, j] = q_g * X[2 - r, 2 - s, i, j] + q_bg * X[3 - r, 3 - s, i, j]
            multiply(DY, D[r], Y)
            for i in range(3):
                for j in range(i + 1 if r == s else 3):
                    q = DY[i, 0] * D[s, j, 0] + DY[i, 1] * D[s, j, 1] + DY[i, 2] * D[s, j, 2]
                    q += P[3 * r + i, 3 * s + j]
                    P[3 * r + i, 3 * s + j] = q
                    P[3 * s + j, 3 * r + i] = q
        multiply(DY, D[r], W[4 - r])
        # b_a acts on p and v alone: minus C h^3/6 and minus C h^2/2
        c = q_ba * (h * h * h / 6.0 if r == 0 else (0.5 * h * h if r == 1 else 0.0))
        for i in range(3):
            for j in range(3):
                P[3 * r + i, 9 + j] -= q_bg * DY[i, j]
                P[9 + j, 3 * r + i] = P[3 * r + i, 9 + j]
                P[3 * r + i, 12 + j] -= c * C[i, j]
                P[12 + j, 3 * r + i] = P[3 * r + i, 12 + j]
    pv = h * h * (0.5 * q_a + q_ba * h * h / 8.0)
    for i in range(3):
        P[i, i] += h * h * h * (q_a / 3.0 + q_ba * h * h / 20.0)
        P[i, 3 + i] += pv
        P[3 + i, i] += pv
        P[3 + i, 3 + i] += h * (q_a + q_ba * h * h / 3.0)
        P[9 + i, 9 + i] += q_bg * h
        P[12 + i, 12 + i] += q_ba * h


@kernel
def predict(
    P: FloatArray,
    A: FloatArray,
    D: FloatArray,
    C: FloatArray,
    S: FloatArray,
    N: FloatArray,
    h: float,
    noise: Noise,
    work: Workspace,
) -> None:
    """P <- Phi P Phi^T + Q over an interval h, in place and exactly symmetric."""
    W, X, Phi = work[1], work[2], work[3]
    write_exponential_integrals(W, A, h)
    write_transition(Phi, W, D, C, S, h, work)
    propagate(P, Phi, h, work)
    write_noise_integrals(X, W, A, N, h, work)
    add_noise(P, X, W, D, C, h, noise, work)


@kernel
def workspace(n: int) -> Workspace:
    """Scratch for a covariance of n states."""
    return (
        np.empty((2, 3, 3)),
        np.empty((DEPTH + 1, 3, 3)),
        np.empty((5, 5, 3, 3)),
        np.empty((MOVING, CORE_SIZE)),
        np.empty((MOVING, n)),
        np.zeros((CORE_SIZE, TURNED)),
        np.empty((MOVING, TURNED)),
    )
