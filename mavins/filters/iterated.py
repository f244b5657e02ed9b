"""The iterated update that `ieskf` and `iekf` share: a Gauss-Newton search from the predicted state x0.

With x = step(x0, s) for a correction s over the canonical errors at x0, it minimizes

    s^T P^-1 s + r(step(x0, s))^T R^-1 r(step(x0, s))

The filters differ in the step. Sources: Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton method"
(1993); Xu and Zhang, "FAST-LIO" (2021), for the gain in state dimension. Theory: docs/theory/ieskf.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar, Final, TypeAlias

import numpy as np

from mavins.filters.base import FilterState, ImuNoise, Observation, Outcome
from mavins.filters.eskf import Eskf
from mavins.filters.settings import FilterSettings
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE, GRAVITY, Layout
from mavins.nav.linalg import gated_update
from mavins.nav.s2 import write_step_jacobian
from mavins.types import FloatArray, IntArray

Rows: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""x (26,) -> (r (m,), H (m, 25), R (m, m)): a measurement linearized at x."""
Accumulate: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""x (26,) -> (H^T R^-1 H (k, k), H^T R^-1 r (k,)): the sums over the rows of a scan, linearized at x."""

BLOCKS: Final = 4
J_L, N_P, N_V, J_R = range(BLOCKS)
"""Places of the 3x3 blocks of G: of dp by dp and dv by dv, of dp and of dv by theta_b, and of theta_b by itself.

G is the derivative of the canonical errors at step(x0, s) by s; further errors are additive in every filter.
"""
J_S: Final = BLOCKS
"""Where gravity's direction is estimated, G has one block more, with its errors' (2, 2) in the upper left."""


@kernel
def write_gravity_block(G: FloatArray, x: FloatArray, s: FloatArray) -> None:
    """The block of gravity's direction in G, where there is one, for the step from x by s."""
    if G.shape[0] > BLOCKS:
        n = len(s)
        write_step_jacobian(G[J_S], (x[24], x[25]), s[n - 2], s[n - 1])


@kernel
def turn_rows(M: FloatArray, G: FloatArray) -> None:
    """M <- G M in place, for M (n, k) with rows of canonical errors and the blocks G (4 or 5, 3, 3) of a step."""
    for c in range(M.shape[1]):
        p0, p1, p2 = M[0, c], M[1, c], M[2, c]
        v0, v1, v2 = M[3, c], M[4, c], M[5, c]
        t0, t1, t2 = M[6, c], M[7, c], M[8, c]
        for i in range(3):
            j0, j1, j2 = G[J_L, i, 0], G[J_L, i, 1], G[J_L, i, 2]
            M[i, c] = (j0 * p0 + j1 * p1 + j2 * p2) + (
                G[N_P, i, 0] * t0 + G[N_P, i, 1] * t1 + G[N_P, i, 2] * t2
            )
            M[3 + i, c] = (j0 * v0 + j1 * v1 + j2 * v2) + (
                G[N_V, i, 0] * t0 + G[N_V, i, 1] * t1 + G[N_V, i, 2] * t2
            )
            M[6 + i, c] = G[J_R, i, 0] * t0 + G[J_R, i, 1] * t1 + G[J_R, i, 2] * t2
        if G.shape[0] > BLOCKS:
            n = M.shape[0]
            g0, g1 = M[n - 2, c], M[n - 1, c]
            M[n - 2, c] = G[J_S, 0, 0] * g0 + G[J_S, 0, 1] * g1
            M[n - 1, c] = G[J_S, 1, 0] * g0 + G[J_S, 1, 1] * g1


@kernel
def turn_covariance(P: FloatArray, G: FloatArray) -> None:
    """P <- G P G^T, in place and exactly symmetric."""
    turn_rows(P, G)
    turn_rows(P.T, G)
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i]


@kernel
def gauss_newton(
    P: FloatArray,
    s: FloatArray,
    G: FloatArray,
    r: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    A: FloatArray,
    S: FloatArray,
) -> tuple[float, float]:
    """One step of the search: s (n,) <- K (r + H G s), A (n, n) <- (I - K H G) P, for r, H and G at step(x0, s).

    Returns (NIS, the longest change of s in sigmas of A); above the gate, or with a nan NIS, s is as it was.
    """
    n, m = P.shape[0], len(r)
    H_s, e, d = H.copy(), r.copy(), np.empty(n)
    for i in range(m):
        for j in range(3):
            p, v, t = 0.0, 0.0, 0.0
            for k in range(3):
                p += H[i, k] * G[J_L, k, j]
                v += H[i, 3 + k] * G[J_L, k, j]
                t += H[i, k] * G[N_P, k, j] + H[i, 3 + k] * G[N_V, k, j]
                t += H[i, 6 + k] * G[J_R, k, j]
            H_s[i, j], H_s[i, 3 + j], H_s[i, 6 + j] = p, v, t
        if G.shape[0] > BLOCKS:
            g0, g1 = H[i, GRAVITY], H[i, GRAVITY + 1]
            H_s[i, GRAVITY] = g0 * G[J_S, 0, 0] + g1 * G[J_S, 1, 0]
            H_s[i, GRAVITY + 1] = g0 * G[J_S, 0, 1] + g1 * G[J_S, 1, 1]
        for j in range(n):
            e[i] += H_s[i, columns[j]] * s[j]
    for i in range(n):
        for j in range(n):
            A[i, j] = P[i, j]
    nis = gated_update(A, e, H_s, R, columns, gate, d, S)
    longest = 0.0
    if nis <= gate:
        for i in range(n):
            longest = max(longest, abs(d[i] - s[i]) / math.sqrt(A[i, i]))
            s[i] = d[i]
    return nis, longest


def compressed(
    information: FloatArray, b: FloatArray, columns: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(r (q,), H (q, 25), R = I) with the same H^T H = `information` (k, k) and H^T r = `b` (k,); q <= k.

    From the eigenvectors of the information, scaled to a unit diagonal so that metres and radians compare; directions
    that no row has seen are left out. r^T r is less than the sum over the rows by what no state can explain.
    """
    unit = np.sqrt(np.diag(information))
    inverse = np.divide(1.0, unit, out=np.zeros_like(unit), where=unit > 0.0)
    eigenvalues, V = np.linalg.eigh(information * inverse[:, np.newaxis] * inverse)
    seen = eigenvalues > len(unit) * np.finfo(float).eps * eigenvalues[-1]
    root = np.sqrt(eigenvalues[seen])
    r = V[:, seen].T @ (inverse * b) / root
    H = np.zeros((len(root), CANONICAL_SIZE))
    H[:, columns] = root[:, np.newaxis] * V[:, seen].T * unit
    return r, H, np.eye(len(root))


class Iterated(Eskf):
    """A filter with the error-state filter's walk and an iterated update along its `step`."""

    step: ClassVar[staticmethod[[FloatArray, FloatArray, IntArray, FloatArray], None]]
    """A kernel of (x (26,), s (n,), columns (n,), G (4 or 5, 3, 3)): x <- step(x, s), and G <- its derivative by s."""

    def __init__(self, noise: ImuNoise, layout: Layout, settings: FilterSettings) -> None:
        super().__init__(noise, layout, settings)
        self._settings = settings.iterated

    def update(self, state: FilterState, observation: Observation, gate: float) -> Outcome:
        """Fuse a measurement; one with more rows than there are error states in the states' dimension."""
        r, H = observation.linearize(state.x, state.u)
        columns, R = self.layout.columns, observation.R
        if len(r) <= len(columns):
            S = np.empty((len(r), len(r)))
            nis = self._search(state, lambda x: (*observation.linearize(x, state.u), R), gate, S)
            return Outcome(nis, r, S)
        h = H[:, columns]
        S = h @ state.P @ h.T + R
        weights = np.linalg.inv(R)

        def accumulate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            r, H = observation.linearize(x, state.u)
            weighted = H[:, columns].T @ weights
            return weighted @ H[:, columns], weighted @ r

        # what no state can explain is the same for every gain, and belongs to the NIS
        rest = float(r @ weights @ r) - float(
            np.sum(compressed(*accumulate(state.x), columns)[0] ** 2)
        )
        return Outcome(self.update_streamed(state, accumulate, columns, gate - rest) + rest, r, S)

    def update_streamed(
        self, state: FilterState, accumulate: Accumulate, columns: IntArray, gate: float
    ) -> float:
        """Fuse the many rows of a scan by their sums over the canonical errors `columns` (k,); returns the NIS.

        `accumulate` is asked again at each iterate. The NIS is that of at most k combined rows, `compressed`.
        """

        def rows(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            return compressed(*accumulate(x), columns)

        return self._search(state, rows, gate, np.empty((len(columns), len(columns))))

    def _search(self, state: FilterState, rows: Rows, gate: float, S: FloatArray) -> float:
        """Search from the predicted state; S (m, m) <- the residuals' covariance there. Returns the NIS there."""
        x, P, columns = state.x, state.P, self.layout.columns
        s, A = np.zeros(len(P)), np.empty_like(P)
        G = np.zeros((BLOCKS + self.layout.has_gravity, 3, 3))
        G[J_L] = G[J_R] = G[J_S:] = np.eye(3)
        nis, longest = gauss_newton(P, s, G, *rows(x), columns, gate, A, S)
        if not nis <= gate:
            return nis
        stepped = self._stepped(x, s, G)
        scratch = np.empty_like(S)
        for _ in range(self._settings.iterations - 1):
            if longest <= self._settings.threshold:
                break
            later, longest = gauss_newton(P, s, G, *rows(stepped), columns, math.inf, A, scratch)
            if math.isnan(later):
                return math.nan
            stepped = self._stepped(x, s, G)
        x[:] = stepped
        turn_covariance(A, G)
        P[:] = A
        return nis

    def _stepped(self, x: FloatArray, s: FloatArray, G: FloatArray) -> FloatArray:
        """step(x, s) (26,), with G <- its derivative."""
        stepped = x.copy()
        self.step(stepped, s, self.layout.columns, G)
        return stepped
