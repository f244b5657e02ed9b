"""The Rauch-Tung-Striebel smoother on the manifold, over the nodes of a filter's forward run.

    d_k = G d_k+1,   P_k|N = P_k|k + G (P_k+1|N - P_k+1|k) G^T,   G = P_k|k Phi^T P_k+1|k^-1

with d = x_N [-] x. The inverse is wanted only where a measurement came in: with

    lam = P^-1 d,   Lam = P^-1 (P - P_N) P^-1

at the last prediction before it, lam <- Phi^T lam and Lam <- Phi^T Lam Phi take both back, and each node on the way has
d = P lam and P_N = P - P Lam P, which is the same.
Sources: Rauch, Tung and Striebel (1965); Sarkka (2013), chapter 8; Bierman (1973) for lam and Lam.
Theory: docs/theory/rts.md.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mavins.filters.walking import pieces_of, reading_at, reading_within
from mavins.nav.ins import (
    CORE_SIZE,
    MOVING,
    Workspace,
    add_gravity_transition,
    apply_transition,
    increments_from_rates,
    mechanize,
    transition,
    workspace,
    write_gravity_transition,
)
from mavins.nav.kernels import kernel
from mavins.nav.layout import boxminus, boxplus
from mavins.nav.linalg import cholesky, reset_attitude_error
from mavins.types import FloatArray, IntArray

MOVED: Final = 0
UPDATED: Final = 1
RESET: Final = 2
"""How a node follows the one before: over an interval, or at its instant by measurements or by a reset."""


@kernel
def step_transition(
    M: FloatArray,
    x: FloatArray,
    u: FloatArray,
    row: FloatArray,
    dt_us: int,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    work: Workspace,
) -> None:
    """M (k, k) <- Phi M over the interval from reading `u` to reading `row`; moves x and u (see eskf.step)."""
    C, A, moved, K = work[0], work[1], work[2], work[5]
    pieces = pieces_of(dt_us)
    h = dt_us * 1e-6 / pieces
    w0, f0 = reading_within(x, u, row, 0.0, dt_us)
    for i in range(pieces):
        w1, f1 = reading_within(x, u, row, (i + 1.0) / pieces, dt_us)
        phi, dv = increments_from_rates(w0, f0, w1, f1, h)
        g = mechanize(x, phi, dv, h, r0_e, C_ne, w_ie_n, C)
        transition(A, C, g, phi, dv, h, w_ie_n)
        # widths from an array, not constants: those would be unrolled into scalar code
        n = M.shape[1]
        apply_transition(M, A, C, h, moved, n, n, n)
        for r in range(MOVING):
            for c in range(n):
                M[r, c] = moved[r, c]
        if K.shape[1]:
            write_gravity_transition(K, x, g, h)
            add_gravity_transition(M, K)
        w0, f0 = w1, f1
    for i in range(6):
        u[i] = row[i]


@kernel
def close_transition(M: FloatArray, out: FloatArray) -> None:
    """Out (9, k) <- the moving rows of M (k, k), the others being the identity's; M <- identity."""
    for r in range(MOVING):
        for c in range(M.shape[1]):
            out[r, c] = M[r, c]
            M[r, c] = 1.0 if r == c else 0.0


@kernel
def walk_transitions(
    M: FloatArray,
    x: FloatArray,
    u: FloatArray,
    start_us: int,
    t_us: IntArray,
    imu: FloatArray,
    due: IntArray,
    until_us: int,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    out: FloatArray,
) -> int:
    """Walk IMU rows as Filter.walk does; out (N, 9, k) <- Phi from due row to due row; returns how many.

    M (k, k) holds Phi since the last node, before and after; x (26,) and u (6,) are moved along. Of the columns of Phi
    there are the core's, or all where gravity's direction is among them.
    """
    work = workspace(M.shape[0], M.shape[0] > CORE_SIZE)
    t = start_us
    count = 0
    for k in range(len(t_us)):
        if t_us[k] > until_us:
            if until_us > t:
                reading = reading_at(u, imu[k], (until_us - t) / (t_us[k] - t))
                step_transition(M, x, u, reading, until_us - t, r0_e, C_ne, w_ie_n, work)
            break
        step_transition(M, x, u, imu[k], t_us[k] - t, r0_e, C_ne, w_ie_n, work)
        t = t_us[k]
        if due[k]:
            close_transition(M, out[count])
            count += 1
    return count


@kernel
def pull_back(lam: FloatArray, Lam: FloatArray, Phi: FloatArray, work: FloatArray) -> None:
    """Turn lam into Phi^T lam and Lam into Phi^T Lam Phi for Phi (9, k), its other rows being the identity's.

    work (n + 1, n) is scratch.
    """
    n = len(lam)
    for i in range(n):
        for c in range(n):
            work[i, c] = 0.0 if c < MOVING else Lam[i, c]
        for r in range(MOVING):
            s = Lam[i, r]
            for c in range(Phi.shape[1]):
                work[i, c] += s * Phi[r, c]
    for i in range(n):
        for c in range(n):
            Lam[i, c] = 0.0 if i < MOVING else work[i, c]
    for i in range(Phi.shape[1]):
        s = 0.0 if i < MOVING else lam[i]
        for r in range(MOVING):
            p = Phi[r, i]
            s += p * lam[r]
            for c in range(n):
                Lam[i, c] += p * work[r, c]
        # lam of a moving state is still asked for by the rows that follow
        work[n, i] = s
    for i in range(Phi.shape[1]):
        lam[i] = work[n, i]
    for i in range(n):
        for c in range(i):
            Lam[c, i] = Lam[i, c]


@kernel
def smooth_node(
    x: FloatArray,
    P: FloatArray,
    lam: FloatArray,
    Lam: FloatArray,
    columns: IntArray,
    work: FloatArray,
    out: FloatArray,
) -> None:
    """X <- x [+] P lam, P <- P - P Lam P over the errors at the new x, in place; work and out have room for (n, n)."""
    n = P.shape[0]
    d = np.zeros(n)
    for i in range(n):
        for c in range(n):
            work[i, c] = 0.0
            out[i, c] = P[i, c]
        for k in range(n):
            s = P[i, k]
            d[i] += s * lam[k]
            for c in range(n):
                work[i, c] += s * Lam[k, c]
    for i in range(n):
        for k in range(n):
            s = work[i, k]
            for c in range(n):
                out[i, c] -= s * P[k, c]
    for i in range(n):
        for c in range(i + 1):
            P[i, c] = P[c, i] = out[i, c]
    boxplus(x, d, columns)
    reset_attitude_error(P, d[6:9])


@kernel
def solve(S: FloatArray, B: FloatArray, m: int) -> None:
    """B (n, m) <- (F F^T)^-1 B for the factor F in S (n, n) that `cholesky` writes."""
    n = S.shape[0]
    for i in range(n):
        for k in range(i):
            s = S[i, k]
            for c in range(m):
                B[i, c] -= s * B[k, c]
        s = S[i, i]
        for c in range(m):
            B[i, c] *= s
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            s = S[k, i]
            for c in range(m):
                B[i, c] -= s * B[k, c]
        s = S[i, i]
        for c in range(m):
            B[i, c] *= s


@kernel
def through_update(
    x: FloatArray,
    P: FloatArray,
    x_N: FloatArray,
    P_N: FloatArray,
    lam: FloatArray,
    Lam: FloatArray,
    columns: IntArray,
) -> bool:
    """Write lam = P^-1 d and Lam = P^-1 (P - P_N) P^-1 for the prediction x, P and what is smoothed at its instant.

    False where P is not positive definite.
    """
    n = P.shape[0]
    F = np.empty((n, n))
    if not cholesky(F, P):
        return False
    d = boxminus(x_N, x, columns)
    B = P_N.copy()
    reset_attitude_error(B, -d[6:9])
    v = np.empty((n, 1))
    for i in range(n):
        v[i, 0] = d[i]
        for c in range(n):
            B[i, c] = P[i, c] - B[i, c]
    solve(F, v, 1)
    solve(F, B, n)
    for i in range(n):
        lam[i] = v[i, 0]
        for c in range(n):
            Lam[i, c] = B[c, i]
    solve(F, Lam, n)
    for i in range(n):
        for c in range(i):
            Lam[i, c] = Lam[c, i] = 0.5 * (Lam[i, c] + Lam[c, i])
    return True


@kernel
def smooth_back(
    kind: IntArray,
    wanted: IntArray,
    x: FloatArray,
    P: FloatArray,
    Phi: FloatArray,
    lam: FloatArray,
    Lam: FloatArray,
    columns: IntArray,
) -> None:
    """Smooth the nodes x (K, 26), P (K, n, n) in place, those that are wanted; lam and Lam are taken from end to start.

    `kind` (K,) says how a node follows the one before, Phi (K, 9, k) is the transition to it where it moved. At a
    reset, and where a prediction is not positive definite, nothing of what came later is passed on.
    """
    n = P.shape[1]
    work, out = np.zeros((n + 1, n)), np.empty((n, n))
    for back in range(len(kind)):
        k = len(kind) - 1 - back
        if wanted[k] or kind[k] == UPDATED:
            smooth_node(x[k], P[k], lam, Lam, columns, work, out)
        if k == 0:
            break
        if kind[k] == MOVED:
            pull_back(lam, Lam, Phi[k], work)
        elif kind[k] == RESET or not through_update(
            x[k - 1], P[k - 1], x[k], P[k], lam, Lam, columns
        ):
            lam.fill(0.0)
            Lam.fill(0.0)
