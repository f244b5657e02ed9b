"""The iterated update: a minimum found, the same in either dimension, and ahead of a single step where it bends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

from mavins.aiding import Measurement, gnss_position
from mavins.filters import FilterSettings, FilterState, ImuNoise, RowBlock, make
from mavins.filters.eskf import Eskf
from mavins.filters.ieskf import Ieskf, manifold_step
from mavins.filters.iterated import BLOCKS, compressed, turn_rows
from mavins.filters.settings import IteratedSettings
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CANONICAL_SIZE, X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import euler_to_quat, quat_to_dcm, quat_to_euler, wrap_pi
from mavins.types import FloatArray, Origin

FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
NOISE = ImuNoise(3e-4, 3e-3, 1e-5, 1e-4)
COLUMNS = Layout.of().columns
POSE = np.array([0, 1, 2, 6, 7, 8])
SIGMA = np.repeat([5.0, 0.3, 0.3, 0.01, 0.1], 3)
SEEDS = range(4)


@dataclass(frozen=True)
class Planes:
    """Points (m, 3) of b on planes normals^T p = offsets of n, with the noise sigma: h = normals^T (C points + p)."""

    points: FloatArray
    normals: FloatArray
    offsets: FloatArray
    sigma: float

    @property
    def R(self) -> FloatArray:
        return self.sigma**2 * np.eye(len(self.points))

    def linearize(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        C = quat_to_dcm(x[6:10])
        r = self.offsets - np.einsum("ij,ij->i", self.normals, self.points @ C.T + x[:3])
        H = np.zeros((len(r), CANONICAL_SIZE))
        H[:, :3] = self.normals
        H[:, 6:9] = np.cross(self.points, self.normals @ C)
        return r, H

    def residuals(self, X: FloatArray, u: FloatArray) -> FloatArray:
        return np.array([self.linearize(x, u)[0] for x in X])

    def sums(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        r, H = self.linearize(x, np.zeros(6))
        J = H[:, POSE] / self.sigma
        return J.T @ J, J.T @ r / self.sigma


def iterated(iterations: int = 4, threshold: float = 0.01) -> Ieskf:
    return Ieskf(
        NOISE, Layout.of(), FilterSettings(iterated=IteratedSettings(iterations, threshold))
    )


def random_state(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    x = np.zeros(X_SIZE)
    x[:16] = rng.normal(size=16) * np.repeat([50.0, 3.0, 0.0, 0.02, 0.2], [3, 3, 4, 3, 3])
    x[6:10] = euler_to_quat(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(-3, 3))
    return x


def prior(x: FloatArray, seed: int) -> FilterState:
    """A state that is wrong by what a correlated covariance says."""
    rng = np.random.default_rng(100 + seed)
    A = rng.normal(size=(15, 15)) * SIGMA[:, np.newaxis] / math.sqrt(15)
    P = A @ A.T + np.diag((0.3 * SIGMA) ** 2)
    wrong = x.copy()
    boxplus(wrong, rng.multivariate_normal(np.zeros(15), P), COLUMNS)
    return FilterState(wrong, P, np.zeros(6), 0)


def scan(x: FloatArray, rows: int, sigma: float, seed: int) -> Planes:
    """What the state x sees of as many planes as there are points, 5 to 40 m away."""
    rng = np.random.default_rng(200 + seed)
    points = rng.normal(size=(rows, 3))
    points *= (rng.uniform(5, 40, rows) / np.linalg.norm(points, axis=1))[:, np.newaxis]
    normals = rng.normal(size=(rows, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, np.newaxis]
    places = points @ quat_to_dcm(x[6:10]).T + x[:3]
    offsets = np.einsum("ij,ij->i", normals, places) + sigma * rng.normal(size=rows)
    return Planes(points, normals, offsets, sigma)


def assert_same(a: FilterState, b: FilterState, tolerance: float = 1e-7) -> None:
    """States and covariances agree in units of the sigmas."""
    scale = np.sqrt(np.diag(b.P))
    assert np.all(np.abs(boxminus(a.x, b.x, COLUMNS)) < tolerance * scale)
    assert_allclose(a.P / np.outer(scale, scale), b.P / np.outer(scale, scale), atol=tolerance)


@pytest.mark.parametrize("size", [1e-4, 0.5, 2.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_a_step(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    x, d = random_state(seed), rng.normal(size=15)
    d[6:9] *= size / np.linalg.norm(d[6:9])
    y, blocks, G = x.copy(), np.empty((BLOCKS, 3, 3)), np.eye(15)
    manifold_step(y, d, COLUMNS, blocks)
    turn_rows(G, blocks)
    h = 1e-6
    for i in range(15):
        ends = []
        for sign in (1.0, -1.0):
            e, z = d.copy(), x.copy()
            e[i] += sign * h
            boxplus(z, e, COLUMNS)
            ends.append(boxminus(z, y, COLUMNS))
        assert_allclose((ends[0] - ends[1]) / (2 * h), G[:, i], atol=1e-7)


@pytest.mark.parametrize("rows", [10, 40])
@pytest.mark.parametrize("seed", SEEDS)
def test_minimum_of_prior_and_measurement(seed: int, rows: int) -> None:
    """Against a least-squares solver that knows nothing of filters, in both dimensions of the gain."""
    x = random_state(seed)
    state, planes = prior(x, seed), scan(x, rows, 0.5, seed)
    begin, L = state.copy(), np.linalg.cholesky(state.P)

    def weighted(s: FloatArray) -> FloatArray:
        y = begin.x.copy()
        boxplus(y, s, COLUMNS)
        return np.concatenate(
            [np.linalg.solve(L, s), planes.linearize(y, state.u)[0] / planes.sigma]
        )

    fit = least_squares(weighted, np.zeros(15), xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale=SIGMA)
    outcome = iterated(50, 1e-9).update(state, planes, math.inf)
    expected = begin.copy()
    G, blocks = np.eye(15), np.empty((BLOCKS, 3, 3))
    manifold_step(expected.x, fit.x, COLUMNS, blocks)
    turn_rows(G, blocks)
    expected.P = G @ np.linalg.inv(fit.jac.T @ fit.jac) @ G.T
    assert_same(state, expected, 1e-4)
    r, H = planes.linearize(begin.x, begin.u)
    S = H[:, COLUMNS] @ begin.P @ H[:, COLUMNS].T + planes.R
    assert_allclose(outcome.innovation, r)
    assert_allclose(outcome.sigma, np.sqrt(np.diag(S)))
    assert outcome.nis == pytest.approx(r @ np.linalg.solve(S, r))


def test_five_thousand_rows_by_their_sums() -> None:
    x = random_state(7)
    streamed, planes = prior(x, 7), scan(x, 5000, 0.1, 7)
    once, begin = streamed.copy(), streamed.copy()
    iterated().update_streamed(streamed, planes.sums, POSE, math.inf)
    iterated(1).update_streamed(once, planes.sums, POSE, math.inf)
    r, H = planes.linearize(begin.x, begin.u)
    W = begin.P @ H[:, COLUMNS].T
    K = np.linalg.solve(H[:, COLUMNS] @ W + planes.R, W.T).T
    expected = begin.copy()
    G, blocks = np.eye(15), np.empty((BLOCKS, 3, 3))
    manifold_step(expected.x, K @ r, COLUMNS, blocks)
    turn_rows(G, blocks)
    expected.P = G @ (begin.P - K @ W.T) @ G.T
    assert_same(once, expected, 1e-5)
    assert np.linalg.norm(streamed.x[:3] - x[:3]) < 0.02
    assert np.linalg.norm(boxminus(streamed.x, x, COLUMNS)[6:9]) < 1e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_few_rows_by_their_sums(seed: int) -> None:
    x = random_state(seed)
    state, planes = prior(x, seed), scan(x, 4, 0.3, seed)
    streamed = state.copy()
    nis = iterated().update(state, planes, math.inf).nis
    assert iterated().update_streamed(streamed, planes.sums, POSE, math.inf) == pytest.approx(nis)
    assert_same(streamed, state)


def test_what_no_row_has_seen_is_as_uncertain_as_before() -> None:
    x = random_state(1)
    state, planes = prior(x, 1), scan(x, 300, 0.1, 1)
    state.P = np.diag(SIGMA**2)
    planes.normals[:] = [0.0, 0.0, 1.0]
    information, b = planes.sums(state.x)
    r, H, R = compressed(information, b, POSE)
    assert len(r) == 3
    assert_array_equal(R, np.eye(3))
    assert_allclose(H[:, POSE].T @ H[:, POSE], information, atol=1e-9 * information.max())
    iterated().update_streamed(state, planes.sums, POSE, math.inf)
    assert_allclose(state.P[:2, :2], np.diag(SIGMA[:2] ** 2), rtol=1e-6, atol=1e-6)
    assert state.P[2, 2] < 0.02**2


@pytest.mark.parametrize("why", ["gate", "nan"])
def test_a_refused_scan_leaves_no_trace(why: str) -> None:
    x = random_state(2)
    state, planes = prior(x, 2), scan(x, 100, 0.1, 2)
    if why == "nan":
        planes.offsets[3] = math.nan
    before = state.copy()
    gate = 1e-3 if why == "gate" else math.inf
    assert not iterated().update_streamed(state, planes.sums, POSE, gate) <= gate
    assert_array_equal(state.x, before.x)
    assert_array_equal(state.P, before.P)


def scans_until_found(algorithm: Ieskf, seed: int) -> int:
    """How many scans of 60 planes it takes from 60 deg and 100 m off to 3 deg and 1 m."""
    x = random_state(seed)
    rng = np.random.default_rng(300 + seed)
    sigma = np.repeat([100.0, 0.3, 0.03, 0.01, 0.1], 3)
    sigma[8] = math.radians(60.0)
    wrong = np.zeros(15)
    wrong[:3] = rng.normal(size=3)
    wrong[:3] *= 100.0 / np.linalg.norm(wrong[:3])
    wrong[6:9] = [0.03 * rng.normal(), 0.03 * rng.normal(), rng.choice([-1, 1]) * sigma[8]]
    state = FilterState(x.copy(), np.diag(sigma**2), np.zeros(6), 0)
    boxplus(state.x, wrong, COLUMNS)
    for k in range(20):
        yaw = quat_to_euler(state.x[6:10])[2] - quat_to_euler(x[6:10])[2]
        if abs(math.degrees(wrap_pi(yaw))) < 3.0 and np.linalg.norm(state.x[:3] - x[:3]) < 1.0:
            return k
        planes = scan(x, 60, 0.3, 1000 * seed + k)
        algorithm.update_streamed(state, planes.sums, POSE, math.inf)
    return 20


def test_iterating_finds_the_way_from_far_off_sooner() -> None:
    counts = np.array(
        [[scans_until_found(iterated(n), seed) for n in (1, 4)] for seed in range(10)]
    )
    assert np.median(counts[:, 1]) <= 2
    assert np.median(counts[:, 0]) > 2 * np.median(counts[:, 1])


@pytest.mark.jit
def test_covariance_after_a_hundred_thousand_steps() -> None:
    rng = np.random.default_rng(8)
    layout = Layout.of((*Layout.of().blocks, "l_b", "tau"))
    algorithm = make("ieskf", NOISE, layout)
    P = np.diag(np.concatenate([SIGMA, np.full(4, 0.1)]) ** 2)
    state = FilterState(random_state(1), P, np.zeros(6), 0)
    rows = RowBlock.empty(1)
    R = np.eye(3) * 0.02**2
    for k in range(25_000):
        imu = rng.normal(size=(4, 6)) * np.repeat([1.0, 5.0], 3)
        t = state.t_us + 4000 * np.arange(1, 5)
        algorithm.walk(state, FRAME, t, imu, int(t[-1]), state.t_us, -1, rows)
        z = 0.1 * rng.normal(size=3)
        m = Measurement("gnss_position", 0, "", 0, 0, z, R, np.empty(0), gnss_position.model, 5.0)
        algorithm.update(state, m, math.inf)
        if k % 1000 == 0:
            assert_array_equal(state.P, state.P.T)
            scale = 1.0 / np.sqrt(np.diag(state.P))
            assert np.linalg.eigvalsh(state.P * scale[:, None] * scale)[0] > 1e-12
    assert np.all(np.isfinite(state.x))


def test_made_by_name() -> None:
    algorithm = make("ieskf", NOISE)
    assert isinstance(algorithm, Ieskf)
    assert isinstance(algorithm, Eskf)


@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_a_step_with_gravity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = Layout.of((*Layout.of().blocks, "g_n")).columns
    x, d = random_state(seed), 0.3 * rng.normal(size=17)
    x[24:26] = 0.2 * rng.normal(size=2)
    y, blocks, G = x.copy(), np.empty((BLOCKS + 1, 3, 3)), np.eye(17)
    manifold_step(y, d, columns, blocks)
    turn_rows(G, blocks)
    h = 1e-6
    for i in range(17):
        ends = []
        for sign in (1.0, -1.0):
            e, z = d.copy(), x.copy()
            e[i] += sign * h
            manifold_step(z, e, columns, np.empty((BLOCKS + 1, 3, 3)))
            ends.append(boxminus(z, y, columns))
        assert_allclose((ends[0] - ends[1]) / (2 * h), G[:, i], atol=1e-6)
