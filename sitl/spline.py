"""Uniform B-splines: curves with exact derivatives that stand exactly still where they should.

Source: de Boor, "A Practical Guide to Splines" (2001), chapters IX-X.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from mavins.types import FloatArray


@functools.cache
def weights(degree: int) -> FloatArray:
    """W (k+1, k+1) of degree k: for u in [0, 1] control point i + j weighs sum_m W[m, j] u^m.

    The Cox-de Boor recursion: w_k,j = ((u + k - j) w_(k-1),(j-1) + (1 + j - u) w_(k-1),j) / k.
    """
    W = np.ones((1, 1))
    for k in range(1, degree + 1):
        lower, W = W, np.zeros((k + 1, k + 1))
        for j in range(k):
            W[:-1, j + 1] += (k - j - 1) / k * lower[:, j]
            W[1:, j + 1] += lower[:, j] / k
            W[:-1, j] += (1 + j) / k * lower[:, j]
            W[1:, j] -= lower[:, j] / k
    return W


@dataclass(frozen=True, slots=True)
class UniformSpline:
    """x(t) = sum_i c_i B_k(t / h - i), C^(k-1), for t from the first to the last control point.

    `orders` holds the control points of x, x', ...: each are the differences of those before, so a
    derivative is 0 to the last bit where neighbouring control points are equal.
    """

    spacing: float
    degree: int
    orders: tuple[FloatArray, ...]

    @classmethod
    def through(
        cls, controls: FloatArray, spacing: float, degree: int, derivatives: int
    ) -> UniformSpline:
        """The spline of `controls` (M, d) at t = 0, h, 2h, ...; at both ends the curve rests.

        It is the controls' sequence smoothed by a bell of variance h^2 (k + 1) / 12 and width
        h (k + 1); `degree` k is odd.
        """
        pad = (degree - 1) // 2
        ends = controls[:1].repeat(pad, 0), controls[-1:].repeat(pad, 0)
        orders = [np.concatenate([ends[0], controls, ends[1]])]
        for _ in range(derivatives):
            orders.append(np.diff(orders[-1], axis=0) / spacing)
        return cls(spacing, degree, tuple(orders))

    def __call__(self, t: FloatArray, order: int = 0) -> FloatArray:
        """The derivative of this order, (N, d), at times t (N,)."""
        c, k = self.orders[order], self.degree - order
        x = t / self.spacing
        i = np.minimum(x.astype(np.int64), len(c) - 1 - k)
        w = np.vander(x - i, k + 1, increasing=True) @ weights(k)
        values: FloatArray = np.einsum("nj,njd->nd", w, c[i[:, None] + np.arange(k + 1)])
        return values


def sharpen(samples: FloatArray, degree: int) -> FloatArray:
    """Control points whose spline passes the samples within O(h^4): c = x - (k + 1) / 24 delta^2 x.

    It undoes the bell's smoothing locally, where interpolation would ring into the rest.
    """
    c = samples.copy()
    c[1:-1] -= (degree + 1) / 24.0 * (samples[2:] - 2.0 * samples[1:-1] + samples[:-2])
    return c


def quintic(
    n: int, spacing: float, begin: tuple[FloatArray, FloatArray], end: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Points (n - 1, d) strictly between (x, x') and, n steps later, (x, x'), with x'' = 0 there.

    x(u) = x0 + V0 u + (10 D - 4 V) u^3 + (-15 D + 7 V) u^4 + (6 D - 3 V) u^5 for u from 0 to 1,
    with V0 = x0' T, V = (x1' - x0') T, D = x1 - x0 - V0.
    """
    (x0, v0), (x1, v1) = begin, end
    duration = n * spacing
    V = (v1 - v0) * duration
    D = x1 - x0 - v0 * duration
    u = np.arange(1, n, dtype=np.float64)[:, None] / n
    curved: FloatArray = u**3 * (
        10.0 * D - 4.0 * V + u * (7.0 * V - 15.0 * D + u * (6.0 * D - 3.0 * V))
    )
    return x0 + v0 * duration * u + curved
