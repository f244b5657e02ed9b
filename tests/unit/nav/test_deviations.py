"""Deviations over an interval are those of the mechanization, for large errors too."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.nav.deviations import (
    GRAVITY,
    INTERVAL,
    MIDDLE,
    moved,
    pushed,
    turned,
    write_interval,
)
from mavins.nav.earth import TangentFrame, gravity_n, replace_by_gravity
from mavins.nav.ins import increments_from_rates, mechanize
from mavins.nav.layout import X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import euler_to_quat
from mavins.types import FloatArray, Origin

FRAME = TangentFrame.at(Origin(math.radians(-33.9), math.radians(151.2), 20.0))
EARTH = (FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n)
CORE = Layout.of().columns
DT = 0.02


def vector(a: FloatArray) -> tuple[float, float, float]:
    return (float(a[0]), float(a[1]), float(a[2]))


def after(x: FloatArray, readings: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(state after, C_nb before, g) with the readings (4, 3): w0, f0, w1, f1, not corrected."""
    y = x.copy()
    w0, f0, w1, f1 = (
        vector(a - b) for a, b in zip(readings, [x[10:13], x[13:16]] * 2, strict=True)
    )
    phi, dv = increments_from_rates(w0, f0, w1, f1, DT)
    C = np.empty((3, 3))
    g = mechanize(y, phi, dv, DT, *EARTH, C)
    return y, C, np.array(g)


def parts(x: FloatArray, readings: FloatArray, e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Odd and even part (9,) of the deviations of +- e."""
    w0, f0, w1, f1 = (
        vector(a - b) for a, b in zip(readings, [x[10:13], x[13:16]] * 2, strict=True)
    )
    phi, dv = increments_from_rates(w0, f0, w1, f1, DT)
    middle = x[:3] + 0.5 * DT * x[3:6]
    _, C, g = after(x, readings)
    c = np.empty(INTERVAL)
    write_interval(c, w0, f0, w1, f1, phi, dv, DT, vector(middle), vector(g), FRAME.w_ie_n, C)
    assert_array_equal(c[MIDDLE : MIDDLE + 3], middle)
    assert_array_equal(c[GRAVITY : GRAVITY + 3], g)
    shift = e[:3] + 0.5 * DT * e[3:6]
    plus, minus = (gravity_n(middle + s * shift, *EARTH[:2]) - g for s in (1.0, -1.0))
    p, v, theta, w, f = (vector(s * e[3 * k : 3 * k + 3]) for k, s in enumerate((1, 1, 1, -1, -1)))
    du = pushed(c, theta, w, f)
    turn = turned(c, theta, w)
    zero = (0.0, 0.0, 0.0)
    odd = (*moved(c, p, v, du[0], vector(0.5 * (plus - minus))), turn[0])
    even = (*moved(c, zero, zero, du[1], vector(0.5 * (plus + minus))), turn[1])
    return np.array(odd).ravel(), np.array(even).ravel()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("without", [None, slice(9, 12), slice(6, 15)])
def test_deviations_are_the_mechanization_s(seed: int, without: slice | None) -> None:
    rng = np.random.default_rng(seed)
    x = np.zeros(X_SIZE)
    x[:6] = rng.normal(size=6) * 30.0
    x[6:10] = euler_to_quat(*rng.uniform(-1.4, 1.4, 3))
    x[10:16] = rng.normal(size=6) * 0.1
    readings = rng.normal(size=(4, 3)) * np.array([2.0, 10.0, 2.0, 10.0])[:, None]
    e = rng.normal(size=15) * np.repeat([30.0, 3.0, 0.5, 0.3, 1.0], 3)
    if without is not None:
        e[without] = 0.0
    centre = after(x, readings)[0]
    ends = []
    for sign in (1.0, -1.0):
        y = x.copy()
        boxplus(y, sign * e, CORE)
        ends.append(boxminus(after(y, readings)[0], centre, CORE)[:9])
    odd, even = parts(x, readings, e)
    assert_allclose(odd, 0.5 * (ends[0] - ends[1]), atol=2e-13)
    assert_allclose(even, 0.5 * (ends[0] + ends[1]), atol=2e-13)


def test_gravity_at_many_places_at_once() -> None:
    places = np.random.default_rng(1).normal(size=(3, 37)) * 1e4
    got = places.copy()
    replace_by_gravity(*got, *EARTH[:2])
    expected = [gravity_n(np.ascontiguousarray(p), *EARTH[:2]) for p in places.T]
    assert_allclose(got.T, expected, rtol=1e-14)
