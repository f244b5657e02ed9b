"""The central-difference filter: its two forms, its second order, its square root over a long time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.aiding import Measurement, gnss_position, heading
from mavins.filters import Filter, FilterSettings, FilterState, ImuNoise, RowBlock, make
from mavins.filters.settings import SrcdkfSettings
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.ins import increments_from_rates, mechanize
from mavins.nav.layout import BLOCKS, X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import euler_to_quat
from mavins.types import FloatArray, Origin

FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
PLACE = np.concatenate([FRAME.r0_e, FRAME.C_ne.ravel()])
NOISE = ImuNoise(0.015, 0.35, 1e-4, 3e-3)
QUIET = ImuNoise(1e-9, 1e-9, 1e-12, 1e-12)
FULL = FilterSettings(srcdkf=SrcdkfSettings(full=True))
SIGMA = np.concatenate([np.repeat([1.0, 0.3, 0.05, 0.01, 0.2], 3), [0.1, 0.1, 0.1, 0.05]])
LAYOUTS = {15: 5, 18: 6, 19: 7}


def layout_of(n: int) -> Layout:
    return Layout.of(list(BLOCKS)[: LAYOUTS[n]])


def state_of(n: int, scale: float = 1.0, seed: int = 5) -> FilterState:
    rng = np.random.default_rng(seed)
    x = np.zeros(X_SIZE)
    x[:6] = rng.normal(size=6) * 10.0
    x[6:10] = euler_to_quat(0.3, -0.2, 2.0)
    x[10:16] = rng.normal(size=6) * 0.01
    x[16:19] = [0.5, -0.2, 0.3]
    A = rng.normal(size=(n, n))
    P = (A @ A.T / n + np.eye(n)) * scale**2 * SIGMA[:n, None] * SIGMA[:n]
    u = np.concatenate([rng.normal(size=3) * 0.3, rng.normal(size=3) * 2.0 + [0, 0, -9.8]])
    return FilterState(x, 0.5 * (P + P.T), u, 0)


def filter_of(
    n: int = 15,
    noise: ImuNoise = NOISE,
    settings: FilterSettings | None = None,
    name: str = "srcdkf",
) -> Filter:
    return make(name, noise, layout_of(n), settings)


def flown(algorithm: Filter, state: FilterState, t: list[int], imu: FloatArray) -> FilterState:
    """The state, adopted and walked through the rows."""
    algorithm.adopt(state)
    algorithm.walk(state, FRAME, np.array(t), imu, t[-1], 0, -1, RowBlock.empty(1))
    return state


def observation(aiding: Any, z: FloatArray, R: FloatArray, parameters: FloatArray) -> Measurement:
    return Measurement(aiding.NAME, aiding.RANK, "", 0, 0, z, R, parameters, aiding.model, 5.0)


def relative(A: FloatArray, B: FloatArray) -> float:
    """The largest difference of two covariances, in sigmas of the second."""
    s = np.sqrt(np.diag(B))
    return float(np.max(np.abs(A - B) / np.outer(s, s)))


@pytest.mark.parametrize("n", LAYOUTS)
def test_the_structural_form_is_the_full_one(n: int) -> None:
    rng = np.random.default_rng(n)
    # with an interval in pieces, and a gap across which the reading is held
    t = np.cumsum([4000] * 20 + [150_000] + [5000] * 10 + [400_000] + [4000] * 5).tolist()
    imu = state_of(n).u + rng.normal(size=(len(t), 6)) * 0.5
    a = flown(filter_of(n), state_of(n), t, imu)
    b = flown(filter_of(n, settings=FULL), state_of(n), t, imu)
    assert_allclose(a.x, b.x, rtol=1e-13, atol=1e-13)
    assert relative(a.P, b.P) < 1e-13
    assert_allclose(a.own, b.own, atol=1e-12)


@pytest.mark.parametrize("n", LAYOUTS)
def test_small_covariances_go_as_in_the_error_state_filter(n: int) -> None:
    noise = ImuNoise(*(1e-4 * NOISE.as_array(Layout.of())).tolist())
    t = [4000 * k for k in range(1, 51)]
    imu = state_of(n).u + np.random.default_rng(1).normal(size=(50, 6)) * 0.5
    a = flown(filter_of(n, noise), state_of(n, 1e-4), t, imu)
    b = flown(filter_of(n, noise, name="eskf"), state_of(n, 1e-4), t, imu)
    assert_allclose(a.x, b.x, atol=1e-8)
    assert relative(a.P, b.P) < 3e-3
    z, R = a.x[:3] + 1e-4, np.eye(3) * 1e-8
    fix = observation(gnss_position, z, R, np.empty(0))
    algorithms = filter_of(n, noise), filter_of(n, noise, name="eskf")
    outcomes = [f.update(s, fix, math.inf) for f, s in zip(algorithms, (a, b), strict=True)]
    assert outcomes[0].nis == pytest.approx(outcomes[1].nis, rel=3e-3)
    assert_allclose(outcomes[0].sigma, outcomes[1].sigma, rtol=3e-3)
    assert relative(a.P, b.P) < 3e-3


def test_mean_and_covariance_of_a_strongly_nonlinear_interval() -> None:
    """A heading known to 35 degrees under a strong push: against many random states through the mechanization."""
    sigma = np.full(15, 1e-3)
    sigma[8] = math.radians(35.0)
    x = state_of(15).x
    x[6:10] = euler_to_quat(0.0, 0.0, 0.4)
    x[10:] = 0.0
    u = np.array([0.0, 0.0, 0.0, 30.0, 0.0, -9.8])
    state = FilterState(x.copy(), np.diag(sigma**2), u.copy(), 0)
    dt = 0.1
    flown(filter_of(noise=QUIET), state, [100_000], u[np.newaxis])
    linear = FilterState(x.copy(), np.diag(sigma**2), u.copy(), 0)
    flown(filter_of(noise=QUIET, name="eskf"), linear, [100_000], u[np.newaxis])

    rng = np.random.default_rng(0)
    core, C = Layout.of().columns, np.empty((3, 3))
    w, f = (0.0, 0.0, 0.0), (30.0, 0.0, -9.8)
    phi, dv = increments_from_rates(w, f, w, f, dt)
    ends = []
    for e in rng.normal(size=(20_000, 15)) * sigma:
        e[9:] = 0.0
        y = x.copy()
        boxplus(y, e, core)
        mechanize(y, phi, dv, dt, FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n, C)
        ends.append(boxminus(y, state.x, core)[3:6])
    velocity = np.array(ends)
    shift = boxminus(linear.x, state.x, core)[3:6]
    # the push is shorter on average than where the heading is right, by 16 %: 0.5 m/s
    assert np.linalg.norm(shift) > 0.4
    assert np.linalg.norm(velocity.mean(axis=0)) < 0.06 * np.linalg.norm(shift)
    truth = np.cov(velocity.T)[:2, :2]
    error = np.linalg.norm(state.P[3:5, 3:5] - truth)
    assert error < 0.3 * np.linalg.norm(linear.P[3:5, 3:5] - truth)


def test_a_walk_does_not_depend_on_its_slices() -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.integers(1000, 9000, 60)).tolist()
    whole, sliced = state_of(15), state_of(15)
    imu = whole.u + rng.normal(size=(60, 6))
    algorithm = filter_of()
    rows = RowBlock.empty(100)
    algorithm.adopt(whole)
    algorithm.walk(whole, FRAME, np.array(t), imu, t[-1], 0, 0, rows)
    algorithm.adopt(sliced)
    pieces = RowBlock.empty(100)
    begin = 0
    for end in (1, 2, 30, 60):
        before = t[begin - 1] if begin else 0
        stamps = np.array(t[begin:end])
        algorithm.walk(sliced, FRAME, stamps, imu[begin:end], t[end - 1], before, 0, pieces)
        begin = end
    for a, b in ((whole.x, sliced.x), (whole.P, sliced.P), (whole.own, sliced.own)):
        assert_array_equal(a, b)
    assert rows.count == pieces.count == 60
    assert_array_equal(rows.P[:60], pieces.P[:60])
    assert_array_equal(rows.P[59], whole.P)


@pytest.mark.jit
@pytest.mark.slow
@pytest.mark.parametrize("noise", [NOISE, ImuNoise(1e-5, 1e-4, 0.0, 0.0)], ids=["rough", "fine"])
def test_the_root_after_many_steps_and_updates(noise: ImuNoise) -> None:
    rng = np.random.default_rng(8)
    algorithm = filter_of(noise=noise)
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    quiet = np.concatenate([FRAME.w_ie_n, -gravity_n(np.zeros(3), FRAME.r0_e, FRAME.C_ne)])
    state = FilterState(x, np.diag(SIGMA[:15] ** 2), quiet.copy(), 0)
    algorithm.adopt(state)
    run, R = 10, np.eye(3) * 0.02**2
    t = np.arange(1, run + 1) * 4000
    rows = RowBlock.empty(1)
    for k in range(10_000):
        shake = np.repeat([0.3, 3.0], 3) * rng.normal(size=(run, 6))
        stamps = state.t_us + t
        until = int(stamps[-1])
        algorithm.walk(state, FRAME, stamps, quiet + shake * (k % 2), until, state.t_us, -1, rows)
        z = rng.normal(size=3) * 0.02
        algorithm.update(state, observation(gnss_position, z, R, np.empty(0)), math.inf)
        yaw = observation(heading, np.zeros(1), np.eye(1) * 1e-4, PLACE)
        algorithm.update(state, yaw, math.inf)
    assert state.t_us == 100_000 * 4000
    assert_array_equal(state.own, np.tril(state.own))
    assert np.all(np.diag(state.own) > 0.0)
    assert_array_equal(state.P, state.P.T)
    scale = 1.0 / np.sqrt(np.diag(state.P))
    assert np.linalg.eigvalsh(state.P * scale[:, None] * scale)[0] > 1e-12
    assert abs(np.linalg.norm(state.x[6:10]) - 1.0) < 1e-14


@pytest.mark.parametrize("gate", [1e-9, -1.0])
def test_what_the_gate_refuses_leaves_no_trace_in_the_root(gate: float) -> None:
    algorithm, state = filter_of(), state_of(15)
    algorithm.adopt(state)
    before = state.copy()
    fix = observation(gnss_position, state.x[:3] + 1.0, np.eye(3), np.empty(0))
    assert algorithm.update(state, fix, gate).nis > gate
    for now, then in ((state.x, before.x), (state.P, before.P), (state.own, before.own)):
        assert_array_equal(now, then)


def test_correlated_rows_are_fused_at_once() -> None:
    algorithm, state = filter_of(), state_of(15)
    state.x[16:19] = 0.0
    algorithm.adopt(state)
    P = state.P.copy()
    R = np.array([[2.0, 0.9, 0.1], [0.9, 1.0, -0.3], [0.1, -0.3, 0.5]])
    r = np.array([0.5, -0.4, 0.3])
    fix = observation(gnss_position, state.x[:3] + r, R, np.empty(0))
    nis, _, covariance = algorithm.update(state, fix, math.inf)
    # without a lever arm a position is linear: the update is Kalman's
    S = P[:3, :3] + R
    assert nis == pytest.approx(r @ np.linalg.solve(S, r))
    assert_allclose(covariance, S)
    d = P[:, :3] @ np.linalg.solve(S, r)
    G = np.eye(15)
    a = 0.5 * d[6:9]
    G[6:9, 6:9] += [[0.0, a[2], -a[1]], [-a[2], 0.0, a[0]], [a[1], -a[0], 0.0]]
    expected = G @ (P - P[:, :3] @ np.linalg.solve(S, P[:3])) @ G.T
    assert relative(state.P, expected) < 1e-12


@pytest.mark.parametrize("yaw", [0.0, math.pi - 0.01])
def test_a_heading_is_the_same_across_the_turn(yaw: float) -> None:
    algorithm, state = filter_of(), state_of(15)
    state.x[6:10] = euler_to_quat(0.0, 0.0, yaw)
    state.x[:3] = 0.0
    state.P = np.diag(SIGMA[:15] ** 2)
    state.P[8, 8] = 0.5**2
    algorithm.adopt(state)
    before = state.x.copy()
    north = observation(heading, np.array([yaw + 0.02]), np.eye(1) * 0.1**2, PLACE)
    outcome = algorithm.update(state, north, math.inf)
    assert outcome.sigma[0] == pytest.approx(math.hypot(0.5, 0.1), rel=1e-2)
    turn = boxminus(state.x, before, Layout.of().columns)[8]
    assert turn == pytest.approx(0.02 * 0.25 / 0.26, rel=2e-2)


@pytest.mark.parametrize("believed", [np.empty(0), np.zeros(1)], ids=["unseen", "seen"])
def test_a_delay_is_seen_through_the_motion(believed: FloatArray) -> None:
    """v = 10 m/s and a position 1 m ahead: the delay is what is least known, whether or not the model sees it too."""
    algorithm, state = filter_of(19), state_of(19)
    state.x[3:6], state.x[16:19] = [10.0, 0.0, 0.0], 0.0
    state.P = np.diag((1e-3 * SIGMA) ** 2)
    state.P[18, 18] = 0.5**2
    algorithm.adopt(state)
    z = state.x[:3] + np.array([1.0, 0.0, 0.0])
    fix = observation(gnss_position, z, np.eye(3) * 1e-4, believed)
    algorithm.update(state, fix, math.inf)
    assert state.x[19] == pytest.approx(-0.1, rel=1e-3)


def test_a_covariance_without_a_root_is_complained_of() -> None:
    algorithm, state = filter_of(), state_of(15)
    algorithm.adopt(state)
    assert not algorithm.complaint(state)
    assert_allclose(state.own.T @ state.own, state.P, atol=1e-14)
    state.P[0, 1] = state.P[1, 0] = 1e3
    algorithm.adopt(state)
    assert "positive definite" in algorithm.complaint(state)
