"""Square roots of covariances: what they stand for does not change when they become triangles again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.nav.linalg import reset_attitude_error
from mavins.nav.square_root import (
    WIDTH,
    add_deviation,
    deviations,
    root_of,
    square_of,
    take_triangle,
    triangularize,
    turn_attitude_deviations,
)
from mavins.types import FloatArray


def covariance(n: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) * rng.uniform(1e-3, 10.0, n)
    P: FloatArray = A.T @ A
    return P


@pytest.mark.parametrize("n", [1, 15, 19])
def test_root_and_square(n: int) -> None:
    P = covariance(n, n)
    S, Q = np.empty((n, n)), np.empty((n, n))
    assert root_of(S, P)
    assert_array_equal(S, np.tril(S))
    assert np.all(np.diag(S) > 0.0)
    square_of(Q, S)
    assert_array_equal(Q, Q.T)
    scale = np.sqrt(np.diag(P))
    assert_allclose(Q / np.outer(scale, scale), P / np.outer(scale, scale), atol=1e-13)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_what_is_not_positive_definite_has_no_root(value: float) -> None:
    P = covariance(5, 0)
    P[2, 2] = value
    assert not root_of(np.empty((5, 5)), P)


@pytest.mark.parametrize(("rows", "n", "count"), [(54, 15, 15), (21, 15, 6), (8, 19, 3), (3, 3, 3)])
def test_reflections_keep_the_products_and_leave_a_triangle(rows: int, n: int, count: int) -> None:
    M = deviations(rows)
    M[:rows, :n] = np.random.default_rng(rows).normal(size=(rows, n)) * np.logspace(-4, 3, n)
    before = M[:, :n].copy()
    triangularize(M, 0, rows, n - 1, count, np.empty(WIDTH))
    scale = np.logspace(-4, 3, n)
    got = M[:, :n] / scale
    assert_allclose(got.T @ got, (before / scale).T @ (before / scale), atol=1e-12 * rows)
    for k in range(count):
        assert not M[k + 1 :, n - 1 - k].any()
    S = np.zeros((n, n))
    take_triangle(S, M, 0, n - 1, count)
    assert_array_equal(S, np.tril(S))
    assert np.all(np.diag(S)[n - count :] > 0.0)
    assert_allclose(S[n - 1] ** 2, M[0, :n] ** 2)


def test_rows_outside_are_left_alone() -> None:
    M = deviations(30)
    M[:30, :6] = np.random.default_rng(2).normal(size=(30, 6))
    M[12:, 3:6] = 0.0
    before = M.copy()
    triangularize(M, 4, 12, 5, 3, np.empty(WIDTH))
    assert_array_equal(M[:4], before[:4])
    assert_array_equal(M[12:], before[12:])
    assert not np.array_equal(M[4:12], before[4:12])


def test_deviations_are_reset_as_a_covariance_is() -> None:
    P = covariance(15, 3)
    S = np.empty((15, 15))
    assert root_of(S, P)
    t = np.array([0.1, -0.2, 0.3])
    turn_attitude_deviations(S, 0, 15, *t)
    reset_attitude_error(P, t)
    assert_allclose(S.T @ S, P, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("k", [0, 7, 14])
def test_one_deviation_more(k: int) -> None:
    P = covariance(15, 3)
    S, Q = np.empty((15, 15)), np.empty((15, 15))
    assert root_of(S, P)
    add_deviation(S, k, 0.7, np.empty(WIDTH))
    square_of(Q, S)
    P[k, k] += 0.49
    scale = np.sqrt(np.diag(P))
    assert_allclose(Q / np.outer(scale, scale), P / np.outer(scale, scale), atol=1e-13)
    assert np.all(np.diag(S) > 0.0)
