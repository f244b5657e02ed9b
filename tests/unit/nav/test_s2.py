"""Gravity's direction on the sphere: boxplus and boxminus, what it does to a vector, and the derivatives of both."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.nav.s2 import (
    difference,
    moved,
    tilted,
    write_gravity_jacobian,
    write_step_jacobian,
)
from mavins.nav.so3 import quat_exp, quat_to_dcm
from mavins.types import FloatArray

CASES = [(seed, size) for seed in range(3) for size in (1e-3, 0.02, 0.7)]


def turn(t: FloatArray | tuple[float, float]) -> FloatArray:
    return quat_to_dcm(quat_exp(np.array([t[0], t[1], 0.0])))


def drawn(seed: int, size: float) -> tuple[tuple[float, float], FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    t = size * rng.normal(size=2)
    return (float(t[0]), float(t[1])), size * rng.normal(size=2), 9.8 * rng.normal(size=3)


@pytest.mark.parametrize(("seed", "size"), CASES)
def test_boxplus_goes_along_the_basis_and_boxminus_comes_back(seed: int, size: float) -> None:
    t, d, _ = drawn(seed, size)
    after = moved(t, d[0], d[1])
    assert_allclose(turn(after)[:, 2], (turn(t) @ turn(d))[:, 2], atol=1e-15)
    assert_allclose(difference(after, t), d, atol=1e-15)


def test_nothing_is_exactly_nothing() -> None:
    assert moved((0.0, 0.0), 0.0, 0.0) == (0.0, 0.0)
    assert tilted((0.0, 0.0), (0.1, -0.2, 9.8)) == (0.1, -0.2, 9.8)


@pytest.mark.parametrize(("seed", "size"), CASES)
def test_how_gravity_turns(seed: int, size: float) -> None:
    t, _, normal = drawn(seed, size)
    g = tilted(t, (normal[0], normal[1], normal[2]))
    assert_allclose(g, turn(t) @ normal, atol=1e-14)
    K, h = np.empty((3, 2)), 1e-6
    write_gravity_jacobian(K, t, g)
    for j, e in enumerate(h * np.eye(2)):
        ends = [turn(moved(t, s * e[0], s * e[1])) @ normal for s in (1.0, -1.0)]
        assert_allclose(K[:, j], (ends[0] - ends[1]) / (2 * h), atol=1e-8)


@pytest.mark.parametrize(("seed", "size"), CASES)
def test_derivative_of_a_step(seed: int, size: float) -> None:
    t, d, _ = drawn(seed, size)
    G, after, h = np.empty((3, 3)), moved(t, d[0], d[1]), 1e-6
    write_step_jacobian(G, t, d[0], d[1])
    for j, e in enumerate(h * np.eye(2)):
        ends = [np.array(difference(moved(t, *(d + s * e)), after)) for s in (1.0, -1.0)]
        assert_allclose(G[:2, j], (ends[0] - ends[1]) / (2 * h), atol=1e-9)
