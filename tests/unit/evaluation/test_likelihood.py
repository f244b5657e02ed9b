from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from mavins.evaluation.likelihood import Flight, Innovations, lasting, log_likelihood
from mavins.evaluation.scoring import scores_of
from mavins.evaluation.tunable import PARAMETERS
from mavins.types import FloatArray


def of(r: FloatArray, S: FloatArray) -> Flight:
    stamps = np.arange(len(r), dtype=np.int64) * 100_000
    return {
        ("gnss_position", r.shape[1]): Innovations(
            stamps, r, np.broadcast_to(S, (len(r), *S.shape))
        )
    }


def draws(n: int, S: FloatArray, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).multivariate_normal(np.zeros(len(S)), S, n)


S3 = np.array([[1.0, 0.3, 0.1], [0.3, 2.0, 0.2], [0.1, 0.2, 0.5]])


def test_gaussian_where_nothing_is_far_out() -> None:
    r = 0.5 * draws(50, S3)
    assert log_likelihood(of(r, S3)) == pytest.approx(
        multivariate_normal(np.zeros(3), S3).logpdf(r).sum()
    )


def test_neither_a_small_nor_a_large_covariance_pays() -> None:
    """With every tenth far out the likeliest scale stays near the other nine's, and S -> 0 costs more and more."""
    r = draws(2000, S3)
    r[::10] *= 30.0

    def cost(log_scale: float) -> float:
        return -log_likelihood(of(r, S3 * math.exp(2.0 * log_scale)))

    best = minimize_scalar(cost, bounds=(-5.0, 5.0), method="bounded").x
    assert 0.0 < best < math.log(2.0)
    assert cost(-6.0) > cost(-4.0) > cost(-2.0) > cost(best) < cost(2.0)


def test_no_covariance_no_likelihood() -> None:
    assert log_likelihood(of(np.ones((2, 1)), np.array([[-1.0]]))) == -math.inf


def test_what_lasts() -> None:
    rng = np.random.default_rng(3)
    e = np.zeros((5000, 1))
    for k, w in enumerate(rng.standard_normal(4999)):
        e[k + 1] = 0.6 * e[k] + 0.8 * w
    assert lasting([of(e, np.eye(1))], "gnss_position") == pytest.approx(0.6, abs=0.05)
    assert abs(lasting([of(draws(5000, S3), S3)], "gnss_position")) < 0.03
    assert lasting([of(e, np.eye(1))], "heading") == 0.0


def test_scores_are_the_slope_and_the_information() -> None:
    """Of a scale of S and a shift of r: analytic for a Gaussian."""
    n, h = 4000, 1e-4
    r = draws(n, S3)

    def at(log_sigma: float, shift: float) -> Flight:
        return of(r + shift, S3 * math.exp(2.0 * log_sigma))

    scores = scores_of([at(0.0, 0.0)], [[at(h, 0.0)], [at(0.0, h)]], np.array([h, h]))
    numeric = [
        (log_likelihood(at(h, 0.0)) - log_likelihood(at(-h, 0.0))) / (2.0 * h),
        (log_likelihood(at(0.0, h)) - log_likelihood(at(0.0, -h))) / (2.0 * h),
    ]
    assert_allclose(scores.gradient, numeric, atol=2.0)
    ones = np.ones(3)
    expected = np.diag([2.0 * 3 * n, n * ones @ np.linalg.inv(S3) @ ones])
    assert_allclose(scores.information, expected, rtol=1e-3, atol=1.0)
    assert_allclose(scores.sigmas()[0], 1.0 / math.sqrt(6.0 * n), rtol=0.3)


@pytest.mark.parametrize("p", PARAMETERS, ids=lambda p: p.path)
def test_the_search_never_leaves_the_bounds(p) -> None:
    for u in np.linspace(-100.0, 100.0, 501):
        assert p.low <= p.value(float(u)) <= p.high
    middle = math.sqrt(p.low * p.high) if p.logarithmic else 0.3 * p.low + 0.7 * p.high
    assert p.value(p.inner(middle)) == pytest.approx(middle)
    h = 1e-6
    u = p.inner(middle)
    scaled = [math.log(v) if p.logarithmic else 10.0 * v for v in (p.value(u + h), p.value(u - h))]
    assert p.slope(u) == pytest.approx((scaled[0] - scaled[1]) / (2.0 * h), rel=1e-4)
    low, high = p.interval(middle, 0.1)
    assert low < middle < high
