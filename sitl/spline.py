"""Uniform B-splines: curves with exact derivatives that stand exactly still where they should.

Source: de Boor, "A Practical Guide to Splines" (2001), chapters IX-X.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from mavins.types import FloatArray


@dataclass(frozen=True, slots=True)
class UniformSpline:
    """x(t) = sum_i c_i B_k(t / h - i), C^(k-1), for t from the first to the last control point.

    `orders` holds x and its derivatives, each a spline of its own: their control points are
    differences, so a derivative is 0 to the last bit where neighbouring control points are equal.
    """

    orders: tuple[BSpline, ...]

    @classmethod
    def through(
        cls, controls: FloatArray, spacing: float, degree: int, derivatives: int
    ) -> UniformSpline:
        """The spline of `controls` (M, d) at t = 0, h, 2h, ...; at both ends the curve rests.

        It is the controls' sequence smoothed by a bell of variance h^2 (k + 1) / 12 and width
        h (k + 1); `degree` k is odd.
        """
        pad = (degree + 1) // 2
        c = np.concatenate([controls[:1].repeat(pad, 0), controls, controls[-1:].repeat(pad, 0)])
        knots = spacing * (np.arange(len(c) + degree + 1) - 2 * pad)
        orders = [BSpline(knots, c, degree)]
        for _ in range(derivatives):
            orders.append(orders[-1].derivative())
        return cls(tuple(orders))

    def __call__(self, t: FloatArray, order: int = 0) -> FloatArray:
        """The derivative of this order, (N, d), at times t (N,)."""
        values: FloatArray = self.orders[order](t)
        return values


def sharpen(samples: FloatArray, degree: int) -> FloatArray:
    """Control points whose spline passes the samples within O(h^4): c = x - (k + 1) / 24 delta^2 x.

    It undoes the bell's smoothing locally, where interpolation would ring into the rest.
    """
    c = samples.copy()
    c[1:-1] -= (degree + 1) / 24.0 * (samples[2:] - 2.0 * samples[1:-1] + samples[:-2])
    return c
