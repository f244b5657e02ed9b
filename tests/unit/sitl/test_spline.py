"""Uniform B-splines against scipy's, their rest, and what leads into and out of a record."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from sitl.spline import UniformSpline, quintic, sharpen, weights


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 7])
def test_weights_sum_to_one(degree):
    u = np.linspace(0.0, 1.0, 11)
    w = np.vander(u, degree + 1, increasing=True) @ weights(degree)
    np.testing.assert_allclose(w.sum(axis=1), 1.0, rtol=1e-14)
    assert w.min() >= -1e-15


@pytest.mark.parametrize("degree", [3, 5, 7])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_it_is_de_boor_s_spline(degree, order):
    controls, h = np.random.default_rng(1).normal(size=(20, 2)), 0.25
    pad = (degree + 1) // 2
    c = np.concatenate([controls[:1].repeat(pad, 0), controls, controls[-1:].repeat(pad, 0)])
    oracle = BSpline(h * (np.arange(len(c) + degree + 1) - 2 * pad), c, degree)
    t = np.linspace(0.0, 19 * h, 333)
    spline = UniformSpline.through(controls, h, degree, 2)
    np.testing.assert_allclose(spline(t, order), oracle(t, nu=order), atol=1e-10)


def test_equal_controls_are_rest():
    controls = np.concatenate([np.full((20, 1), 0.1), np.linspace(0.1, 3.0, 20)[:, None]])
    spline = UniformSpline.through(controls, 0.1, 7, 2)
    t = np.linspace(0.0, 1.5, 100)
    assert np.all(spline(t, 1) == 0.0)
    assert np.all(spline(t, 2) == 0.0)


def test_sharpened_samples_are_met():
    t = 0.5 * np.arange(60)
    samples = np.sin(0.5 * t)[:, None]
    plain = UniformSpline.through(samples, 0.5, 7, 0)(t) - samples
    sharp = UniformSpline.through(sharpen(samples, 7), 0.5, 7, 0)(t) - samples
    assert np.abs(plain[10:-10]).max() > 1e-2
    assert np.abs(sharp[10:-10]).max() < 5e-4


def test_a_quintic_joins_two_states_of_motion():
    x0, v0 = np.array([1.0, -2.0]), np.array([3.0, 0.0])
    x1, v1 = np.array([40.0, 5.0]), np.array([-1.0, 2.0])
    n, h = 1000, 0.01
    x = np.concatenate([[x0], quintic(n, h, (x0, v0), (x1, v1)), [x1]])
    v = np.diff(x, axis=0) / h
    np.testing.assert_allclose(v[[0, -1]], [v0, v1], atol=1e-3)
    np.testing.assert_allclose(np.diff(v, axis=0)[[0, -1]] / h, 0.0, atol=0.1)
