"""The iterated error-state Kalman filter: each update is a Gauss-Newton search on the manifold.

With x = x0 [+] s for the predicted state x0, the update minimizes

    s^T P^-1 s + r(x0 [+] s)^T R^-1 r(x0 [+] s)

where `eskf` takes the first step alone. Sources: Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton
method" (1993); Qin et al., "LINS" (2020); Xu and Zhang, "FAST-LIO" (2021), for the manifold and the gain in state
dimension. Theory: docs/theory/ieskf.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from mavins.filters.base import FilterState, ImuNoise, Observation, Outcome
from mavins.filters.eskf import Eskf
from mavins.filters.settings import FilterSettings
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE, Layout, boxplus
from mavins.nav.linalg import gated_update
from mavins.nav.so3 import write_right_jacobian
from mavins.types import FloatArray, IntArray

Rows: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""x (20,) -> (r (m,), H (m, 19), R (m, m)): a measurement linearized at x."""
Accumulate: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""x (20,) -> (H^T R^-1 H (k, k), H^T R^-1 r (k,)): the sums over the rows of a scan, linearized at x."""


@kernel
def gauss_newton(
    P: FloatArray,
    s: FloatArray,
    r: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    A: FloatArray,
    sigma: FloatArray,
) -> tuple[float, float]:
    """One step of the search: s (n,) <- K (r + H J s), A (n, n) <- (I - K H J) P, for r and H at x0 [+] s.

    J = d((x0 [+] s) [-] x) / d s is Jr(theta) on the attitude, the identity elsewhere: the inverse of what the prior's
    [-] is differentiated to at the iterate. Returns (NIS, the longest change of s in sigmas of A); above the gate, or
    with a nan NIS, s is as it was.
    """
    n, m = P.shape[0], len(r)
    J = np.empty((3, 3))
    write_right_jacobian(J, s[6], s[7], s[8])
    H_s, e, d = H.copy(), r.copy(), np.empty(n)
    for i in range(m):
        for j in range(3):
            H_s[i, 6 + j] = H[i, 6] * J[0, j] + H[i, 7] * J[1, j] + H[i, 8] * J[2, j]
        for j in range(n):
            e[i] += H_s[i, columns[j]] * s[j]
    for i in range(n):
        for j in range(n):
            A[i, j] = P[i, j]
    nis = gated_update(A, e, H_s, R, columns, gate, d, sigma)
    longest = 0.0
    if nis <= gate:
        for i in range(n):
            longest = max(longest, abs(d[i] - s[i]) / math.sqrt(A[i, i]))
            s[i] = d[i]
    return nis, longest


@kernel
def settle(x: FloatArray, P: FloatArray, s: FloatArray, A: FloatArray, columns: IntArray) -> None:
    """X <- x [+] s and P <- G A G^T, exactly symmetric, with G = Jr(theta) on the attitude block."""
    boxplus(x, s, columns)
    n = P.shape[0]
    J = np.empty((3, 3))
    write_right_jacobian(J, s[6], s[7], s[8])
    for i in range(n):
        for j in range(n):
            P[i, j] = A[i, j]
    for i in range(3):
        for c in range(n):
            P[6 + i, c] = J[i, 0] * A[6, c] + J[i, 1] * A[7, c] + J[i, 2] * A[8, c]
    for c in range(n):
        t0, t1, t2 = P[c, 6], P[c, 7], P[c, 8]
        for i in range(3):
            P[c, 6 + i] = J[i, 0] * t0 + J[i, 1] * t1 + J[i, 2] * t2
    for i in range(6, 9):
        for j in range(n):
            if j < 6 or j > i:
                P[i, j] = P[j, i]


def compressed(
    information: FloatArray, b: FloatArray, columns: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(r (q,), H (q, 19), R = I) with the same H^T H = `information` (k, k) and H^T r = `b` (k,); q <= k.

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


class Ieskf(Eskf):
    """The iterated filter behind the estimator's `Filter` interface; its walk is the error-state filter's."""

    def __init__(self, noise: ImuNoise, layout: Layout, settings: FilterSettings) -> None:
        super().__init__(noise, layout, settings)
        self._settings = settings.iterated

    def update(self, state: FilterState, observation: Observation, gate: float) -> Outcome:
        """Fuse a measurement; one with more rows than there are error states in the states' dimension."""
        r, H = observation.linearize(state.x, state.u)
        columns, R = self.layout.columns, observation.R
        if len(r) <= len(columns):
            sigma = np.empty(len(r))
            nis = self._search(
                state, lambda x: (*observation.linearize(x, state.u), R), gate, sigma
            )
            return Outcome(nis, r, sigma)
        h = H[:, columns]
        sigma = np.sqrt(np.einsum("ij,jk,ik->i", h, state.P, h) + np.diag(R))
        weights = np.linalg.inv(R)

        def accumulate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            r, H = observation.linearize(x, state.u)
            weighted = H[:, columns].T @ weights
            return weighted @ H[:, columns], weighted @ r

        # what no state can explain is the same for every gain, and belongs to the NIS
        rest = float(r @ weights @ r) - float(
            np.sum(compressed(*accumulate(state.x), columns)[0] ** 2)
        )
        return Outcome(
            self.update_streamed(state, accumulate, columns, gate - rest) + rest, r, sigma
        )

    def update_streamed(
        self, state: FilterState, accumulate: Accumulate, columns: IntArray, gate: float
    ) -> float:
        """Fuse the many rows of a scan by their sums over the canonical errors `columns` (k,); returns the NIS.

        `accumulate` is asked again at each iterate. The NIS is that of at most k combined rows, `compressed`.
        """

        def rows(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            return compressed(*accumulate(x), columns)

        return self._search(state, rows, gate, np.empty(len(columns)))

    def _search(self, state: FilterState, rows: Rows, gate: float, sigma: FloatArray) -> float:
        """Iterate from the predicted state; sigma (m,) <- sqrt(diag S) there. Returns the NIS there."""
        x, P, columns = state.x, state.P, self.layout.columns
        s, A = np.zeros(len(P)), np.empty_like(P)
        nis, longest = gauss_newton(P, s, *rows(x), columns, gate, A, sigma)
        if not nis <= gate:
            return nis
        scratch = np.empty_like(sigma)
        for _ in range(self._settings.iterations - 1):
            if longest <= self._settings.threshold:
                break
            iterate = x.copy()
            boxplus(iterate, s, columns)
            later, longest = gauss_newton(P, s, *rows(iterate), columns, math.inf, A, scratch)
            if math.isnan(later):
                return math.nan
        settle(x, P, s, A, columns)
        return nis
