"""Van Loan's discretization of navigation errors whose dynamics are constant over an interval, in closed form.

    p' = v                                 white noises: on theta the gyro's, on v the accelerometer's,
    v' = B theta - C b_a                   on b_g and b_a those of their walks
    theta' = A theta - b_g
    b_g' = 0,  b_a' = 0

Phi = exp(F h) and Q = int_0^h exp(F s) G exp(F^T s) ds are what Van Loan reads off an exponential of twice the size.
Here everything but A is nilpotent, so both are made of series in A, and of integrals of their products:

    W_k(s) = sum_i A^i s^(i+k) / (i+k)!,   W_k' = W_(k-1),   W_k = s^k / k! + A W_(k+1)
    Y_jk = int_0^h q_g W_j W_k^T + q_bg W_(j+1) W_(k+1)^T ds = T_jk^T + A Y_(j+1)k
    T_jk = int_0^h q_g s^j / j! W_k + q_bg s^(j+1) / (j+1)! W_(k+1) ds, by parts a sum of W_i

The descents start from the first terms of W_8 and of Y_33, which is enough for |A h| below 1. Matrices (3, 3)
lie in one stack, at the places named below: to take one out as an array of its own costs as much as a product.

Source: Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23 (1978).
Theory: docs/theory/euler_ekf.md.
"""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np

from mavins.nav.ins import CORE_SIZE, MOVING, TURNED
from mavins.nav.kernels import kernel
from mavins.types import FloatArray

Workspace: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""The stack of matrices, Phi (9, 15), and scratch."""
Noise: TypeAlias = tuple[float, float, float, float]
"""PSDs of the white noises: gyro, accelerometer, and the walks of their biases."""

A: Final = 0
B: Final = 1
C: Final = 2
BEFORE: Final = 3
AFTER: Final = 4
"""What a caller puts into the stack. theta is multiplied by BEFORE before the interval and by AFTER after it."""
E: Final = 5
E_INV: Final = 6
SPARE: Final = 7
"""Places for intermediate results."""
A_SQ: Final = 8
W: Final = 9
DEPTH: Final = 8
"""W_k lies at W + k, k = 0 .. DEPTH."""
Y_33, Y_23, Y_22, Y_12, Y_02, Y_11, Y_01, Y_00 = range(W + DEPTH + 1, W + DEPTH + 9)
STACK: Final = Y_00 + 1

DESCENT: Final = (
    (Y_23, Y_33, 2, 3),
    (Y_22, Y_23, 2, 2),
    (Y_12, Y_22, 1, 2),
    (Y_02, Y_12, 0, 2),
    (Y_11, Y_12, 1, 1),
    (Y_01, Y_11, 0, 1),
    (Y_00, Y_01, 0, 0),
)
"""(Y_jk, what it descends from, j, k), in this order."""
TRANSITION: Final = ((0, B, 2), (3, B, 1), (6, AFTER, 0))
"""Rows of p, v and theta: (row, left factor, order of the integral that leads theta there)."""
NOISE: Final = (
    (0, B, Y_22, 0, B),
    (3, B, Y_12, 0, B),
    (3, B, Y_11, 3, B),
    (6, AFTER, Y_02, 0, B),
    (6, AFTER, Y_01, 3, B),
    (6, AFTER, Y_00, 6, AFTER),
)
"""Blocks of Q: (row, left factor, middle factor, column, right factor, which is to be transposed)."""


@kernel
def multiply(M: FloatArray, out: int, a: int, b: int) -> None:
    """M[out] <- M[a] M[b] in a stack (k, 3, 3); out is neither a nor b."""
    for i in range(3):
        for j in range(3):
            M[out, i, j] = (
                M[a, i, 0] * M[b, 0, j] + M[a, i, 1] * M[b, 1, j] + M[a, i, 2] * M[b, 2, j]
            )


@kernel
def write_exponential_integrals(M: FloatArray, h: float) -> None:
    """M[W + k] <- W_k(h): W_0 = exp(A h), each further one the integral of the one before; M[A_SQ] <- A^2."""
    c = 1.0
    for k in range(1, DEPTH + 1):
        c *= h / k
    c1 = c * h / (DEPTH + 1.0)
    c2 = c1 * h / (DEPTH + 2.0)
    multiply(M, A_SQ, A, A)
    for i in range(3):
        for j in range(3):
            M[W + DEPTH, i, j] = c1 * M[A, i, j] + c2 * M[A_SQ, i, j]
        M[W + DEPTH, i, i] += c
    for k in range(DEPTH - 1, -1, -1):
        c *= (k + 1.0) / h
        multiply(M, W + k, A, W + k + 1)
        for i in range(3):
            M[W + k, i, i] += c


@kernel
def begin_descent(M: FloatArray, h: float, q_g: float, q_bg: float) -> None:
    """M[Y_33] <- the first terms of Y_33(h) in A."""
    h7 = h * h * h * h * h * h * h
    g, b = q_g * h7, q_bg * h7 * h * h
    c = g / 252.0 + b / 5184.0
    c1 = h * (g / 1152.0 + b / 28800.0)
    c2 = h * h * (g / 6480.0 + b / 190080.0)
    c11 = h * h * (g / 5184.0 + b / 158400.0)
    for i in range(3):
        for j in range(3):
            A_A = M[A, i, 0] * M[A, j, 0] + M[A, i, 1] * M[A, j, 1] + M[A, i, 2] * M[A, j, 2]
            M[Y_33, i, j] = (
                c1 * (M[A, i, j] + M[A, j, i]) + c2 * (M[A_SQ, i, j] + M[A_SQ, j, i]) + c11 * A_A
            )
        M[Y_33, i, i] += c


@kernel
def write_noise_integrals(M: FloatArray, h: float, q_g: float, q_bg: float, c: FloatArray) -> None:
    """M[Y_jk] <- Y_jk(h) for j <= k <= 2, with c (3, 5) as scratch: T_jk = sum over i of c_ji W_(k+1+i)."""
    h2, h3 = h * h / 2.0, h * h * h / 6.0
    c[0, 0], c[0, 1], c[0, 2], c[0, 3], c[0, 4] = q_g, q_bg * h, -q_bg, 0.0, 0.0
    c[1, 0], c[1, 1], c[1, 2], c[1, 3], c[1, 4] = q_g * h, q_bg * h2 - q_g, -q_bg * h, q_bg, 0.0
    c[2, 0], c[2, 1], c[2, 2] = q_g * h2, q_bg * h3 - q_g * h, q_g - q_bg * h2
    c[2, 3], c[2, 4] = q_bg * h, -q_bg
    begin_descent(M, h, q_g, q_bg)
    for out, above, j, k in DESCENT:
        w = W + k + 1
        # a Y with j = k descends from one with j > k, whose mirror image is there
        for a in range(3):
            for b in range(3):
                t = c[j, 0] * M[w, b, a]
                for i in range(1, 5):
                    t += c[j, i] * M[w + i, b, a]
                for i in range(3):
                    t += M[A, a, i] * (M[above, b, i] if j == k else M[above, i, b])
                M[out, a, b] = t


@kernel
def write_transition(M: FloatArray, Phi: FloatArray, h: float) -> None:
    """Phi (9, 15) <- the rows of p, v and theta of exp(F h), their columns from theta on.

    The first six columns hold nothing: p <- p + h v + .., v <- v + .. is known (see apply_transition).
    """
    for row, left, k in TRANSITION:
        multiply(M, SPARE, left, W + k)
        for i in range(3):
            for j in range(3):
                Phi[row + i, 6 + j] = (
                    M[SPARE, i, 0] * M[BEFORE, 0, j]
                    + M[SPARE, i, 1] * M[BEFORE, 1, j]
                    + M[SPARE, i, 2] * M[BEFORE, 2, j]
                )
        multiply(M, SPARE, left, W + k + 1)
        for i in range(3):
            for j in range(3):
                Phi[row + i, 9 + j] = -M[SPARE, i, j]
    for i in range(3):
        for j in range(3):
            Phi[i, 12 + j] = -0.5 * h * h * M[C, i, j]
            Phi[3 + i, 12 + j] = -h * M[C, i, j]


@kernel
def apply_transition(
    M: FloatArray, Phi: FloatArray, h: float, out: FloatArray, n_p: int, n_v: int, n_t: int
) -> None:
    """Out (9, k) <- the moving rows of Phi M for M (n, k), whose first 15 rows are the core errors.

    Of the rows of p, v and theta only the first n_p, n_v and n_t columns are found.
    """
    for i in range(3):
        t0, t1, t2 = Phi[i, 6], Phi[i, 7], Phi[i, 8]
        g0, g1, g2 = Phi[i, 9], Phi[i, 10], Phi[i, 11]
        a0, a1, a2 = Phi[i, 12], Phi[i, 13], Phi[i, 14]
        # one output row a loop: only then does the compiler work on several columns at once
        for c in range(n_p):
            out[i, c] = (
                (M[i, c] + h * M[3 + i, c])
                + (t0 * M[6, c] + t1 * M[7, c] + t2 * M[8, c])
                + (g0 * M[9, c] + g1 * M[10, c] + g2 * M[11, c])
                + (a0 * M[12, c] + a1 * M[13, c] + a2 * M[14, c])
            )
        t0, t1, t2 = Phi[3 + i, 6], Phi[3 + i, 7], Phi[3 + i, 8]
        g0, g1, g2 = Phi[3 + i, 9], Phi[3 + i, 10], Phi[3 + i, 11]
        a0, a1, a2 = Phi[3 + i, 12], Phi[3 + i, 13], Phi[3 + i, 14]
        for c in range(n_v):
            out[3 + i, c] = (
                (M[3 + i, c] + (t0 * M[6, c] + t1 * M[7, c] + t2 * M[8, c]))
                + (g0 * M[9, c] + g1 * M[10, c] + g2 * M[11, c])
                + (a0 * M[12, c] + a1 * M[13, c] + a2 * M[14, c])
            )
        t0, t1, t2 = Phi[6 + i, 6], Phi[6 + i, 7], Phi[6 + i, 8]
        g0, g1, g2 = Phi[6 + i, 9], Phi[6 + i, 10], Phi[6 + i, 11]
        for c in range(n_t):
            out[6 + i, c] = (t0 * M[6, c] + t1 * M[7, c] + t2 * M[8, c]) + (
                g0 * M[9, c] + g1 * M[10, c] + g2 * M[11, c]
            )


@kernel
def add_bias_noise(half: FloatArray, M: FloatArray, h: float, noise: Noise) -> None:
    """Half (9, n) <- half + the rows of p, v and theta of Q, their columns of b_g and b_a."""
    q_bg, q_ba = noise[2], noise[3]
    for row, left, k in TRANSITION:
        multiply(M, SPARE, left, W + k + 2)
        for i in range(3):
            for j in range(3):
                half[row + i, 9 + j] -= q_bg * M[SPARE, i, j]
    for i in range(3):
        for j in range(3):
            half[i, 12 + j] -= q_ba * h * h * h / 6.0 * M[C, i, j]
            half[3 + i, 12 + j] -= q_ba * h * h / 2.0 * M[C, i, j]


@kernel
def add_noise(block: FloatArray, M: FloatArray, h: float, noise: Noise) -> None:
    """Block (9, 9) <- block + Q of p, v and theta, on and below the diagonal, for a C with C C^T = I."""
    for row, left, y, column, right in NOISE:
        multiply(M, SPARE, left, y)
        for i in range(3):
            for j in range(3):
                block[row + i, column + j] += (
                    M[SPARE, i, 0] * M[right, j, 0]
                    + M[SPARE, i, 1] * M[right, j, 1]
                    + M[SPARE, i, 2] * M[right, j, 2]
                )
    q_a, q_ba = noise[1], noise[3]
    for i in range(3):
        block[i, i] += h * h * h * (q_a / 3.0 + q_ba * h * h / 20.0)
        block[3 + i, i] += h * h * (q_a / 2.0 + q_ba * h * h / 8.0)
        block[3 + i, 3 + i] += h * (q_a + q_ba * h * h / 3.0)


@kernel
def predict(P: FloatArray, h: float, noise: Noise, work: Workspace) -> None:
    """P <- Phi P Phi^T + Q over an interval h, in place and exactly symmetric."""
    n = P.shape[0]
    M, Phi, half, turned, block, c = work
    write_exponential_integrals(M, h)
    write_noise_integrals(M, h, noise[0], noise[2], c)
    write_transition(M, Phi, h)
    apply_transition(P, Phi, h, half, n, n, n)
    for j in range(CORE_SIZE):
        for i in range(MOVING):
            turned[j, i] = half[i, j]
    # widths from an array, not constants: those would be unrolled into scalar code
    third = turned.shape[1] // 3
    apply_transition(turned, Phi, h, block, third, 2 * third, 3 * third)
    add_bias_noise(half, M, h, noise)
    add_noise(block, M, h, noise)
    for i in range(MOVING):
        for j in range(i + 1):
            P[i, j] = block[i, j]
            P[j, i] = block[i, j]
        for j in range(MOVING, n):
            P[i, j] = half[i, j]
            P[j, i] = half[i, j]
    for i in range(3):
        P[9 + i, 9 + i] += noise[2] * h
        P[12 + i, 12 + i] += noise[3] * h


@kernel
def workspace(n: int) -> Workspace:
    """Room for a covariance of n states."""
    return (
        np.empty((STACK, 3, 3)),
        np.empty((MOVING, CORE_SIZE)),
        np.empty((MOVING, n)),
        np.zeros((CORE_SIZE, TURNED)),
        np.empty((MOVING, TURNED)),
        np.empty((3, 5)),
    )
