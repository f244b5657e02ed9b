"""The update: against the textbook's formulas, its gate, and what it must leave alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.nav.layout import BLOCKS, CANONICAL_SIZE, CORE, X_SIZE, Layout, boxminus, boxplus
from mavins.nav.linalg import gated_update, is_sane, reset_attitude_error
from mavins.types import FloatArray

CORE_COLUMNS = Layout.of().columns
ALL_COLUMNS = Layout.of(BLOCKS).columns


def spd(rng: np.random.Generator, n: int, spread: float = 1.0) -> FloatArray:
    A = rng.normal(size=(n, n)) * np.exp(spread * rng.normal(size=n))[:, None]
    P = A @ A.T + 1e-3 * np.eye(n)
    return 0.5 * (P + P.T)


def problem(
    seed: int, m: int, columns: np.ndarray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(m, CANONICAL_SIZE)) * (rng.uniform(size=(m, CANONICAL_SIZE)) < 0.5)
    return spd(rng, len(columns)), rng.normal(size=m), H, spd(rng, m)


def updated(
    P: FloatArray, r: FloatArray, H: FloatArray, R: FloatArray, columns: np.ndarray, gate: float
) -> tuple[float, FloatArray]:
    d = np.empty(len(columns))
    return gated_update(P, r, H, R, columns, gate, d, np.empty((len(r), len(r)))), d


@pytest.mark.parametrize("columns", [CORE_COLUMNS, ALL_COLUMNS], ids=["15", "25"])
@pytest.mark.parametrize("m", [1, 2, 3, 6])
@pytest.mark.parametrize("seed", range(3))
def test_update_is_the_textbook_s(seed: int, m: int, columns: np.ndarray) -> None:
    P, r, H, R = problem(seed, m, columns)
    h = H[:, columns]
    S = h @ P @ h.T + R
    K = P @ h.T @ np.linalg.inv(S)
    I_KH = np.eye(len(columns)) - K @ h
    expected = I_KH @ P @ I_KH.T + K @ R @ K.T
    got = P.copy()
    nis, d = updated(got, r, H, R, columns, math.inf)
    assert nis == pytest.approx(r @ np.linalg.solve(S, r), rel=1e-10)
    assert_allclose(d, K @ r, rtol=1e-8, atol=1e-10)
    assert_allclose(got, expected, rtol=1e-8, atol=1e-10 * np.abs(P).max())
    assert_array_equal(got, got.T)


def test_inputs_are_not_written_to() -> None:
    P, r, H, R = problem(1, 3, CORE_COLUMNS)
    copies = r.copy(), H.copy(), R.copy()
    updated(P, r, H, R, CORE_COLUMNS, math.inf)
    for now, before in zip((r, H, R), copies, strict=True):
        assert_array_equal(now, before)


@pytest.mark.parametrize("m", [1, 3, 6])
def test_the_gate_is_joint_and_shuts_without_a_trace(m: int) -> None:
    P, r, H, R = problem(7, m, CORE_COLUMNS)
    nis, _ = updated(P.copy(), r, H, R, CORE_COLUMNS, math.inf)
    before = P.copy()
    refused, _ = updated(P, r, H, R, CORE_COLUMNS, nis * (1 - 1e-9))
    assert_array_equal(P, before)
    assert refused == nis
    accepted, _ = updated(P, r, H, R, CORE_COLUMNS, nis * (1 + 1e-9))
    assert accepted == nis
    assert np.trace(P) < np.trace(before)


@pytest.mark.parametrize("bad", [-1.0, 0.0, math.nan, math.inf])
def test_noise_that_is_no_covariance_is_refused(bad: float) -> None:
    P, r, H, R = problem(2, 3, CORE_COLUMNS)
    before = P.copy()
    R[1, 1] = bad
    nis, _ = updated(P, r, H, R, CORE_COLUMNS, math.inf)
    assert math.isnan(nis)
    assert_array_equal(P, before)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_residual_that_is_no_number_is_refused(bad: float) -> None:
    P, r, H, R = problem(2, 3, CORE_COLUMNS)
    before = P.copy()
    r[2] = bad
    nis, _ = updated(P, r, H, R, CORE_COLUMNS, math.inf)
    assert not nis <= 1e300
    assert_array_equal(P, before)


def test_a_broken_covariance_is_refused() -> None:
    P, r, H, R = problem(2, 1, CORE_COLUMNS)
    P[3, 3] = -1e9
    H[0] = 0.0
    H[0, 3] = 1.0
    assert math.isnan(updated(P, r, H, R, CORE_COLUMNS, math.inf)[0])


def test_an_exact_measurement_of_a_vague_state() -> None:
    P = np.diag(np.full(15, 1e4))
    H = np.zeros((3, CANONICAL_SIZE))
    H[:, :3] = np.eye(3)
    for _ in range(5):
        updated(P, np.ones(3), H, np.eye(3) * 1e-8, CORE_COLUMNS, math.inf)
    assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    assert_allclose(np.diag(P)[:3], 1e-8 / 5, rtol=1e-3)


@pytest.mark.parametrize("gate", [0.0, math.inf])
def test_covariance_of_the_innovation(gate: float) -> None:
    P, r, H, R = problem(4, 3, CORE_COLUMNS)
    h = H[:, CORE_COLUMNS]
    expected, S = h @ P @ h.T + R, np.empty((3, 3))
    gated_update(P, r, H, R, CORE_COLUMNS, gate, np.empty(15), S)
    assert_allclose(S, expected, rtol=1e-12)


@pytest.mark.parametrize("size", [15, 25])
def test_reset_moves_the_error_to_the_new_attitude(size: int) -> None:
    """Errors about x become errors about x [+] d: the Jacobian is numeric, the kernel's is Jr to first order."""
    layout = Layout.of(CORE if size == 15 else BLOCKS)
    rng = np.random.default_rng(5)
    theta = np.array([2e-3, -3e-3, 1e-3])
    d = np.zeros(size)
    d[6:9] = theta
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    moved = x.copy()
    boxplus(moved, d, layout.columns)
    G = np.empty((size, size))
    h = 1e-6
    for i in range(size):
        ends = []
        for sign in (1.0, -1.0):
            y = x.copy()
            e = d.copy()
            e[i] += sign * h
            boxplus(y, e, layout.columns)
            ends.append(boxminus(y, moved, layout.columns))
        G[:, i] = (ends[0] - ends[1]) / (2 * h)
    P = spd(rng, size)
    expected = G @ P @ G.T
    reset_attitude_error(P, theta)
    assert_allclose(P, expected, atol=1e-5 * np.abs(expected).max())
    assert_array_equal(P, P.T)


def test_sanity() -> None:
    x, P = np.zeros(X_SIZE), np.eye(15)
    assert is_sane(x, P)
    x[4] = math.nan
    assert not is_sane(x, P)
    x[4] = 0.0
    P[3, 3] = 0.0
    assert not is_sane(x, P)
