"""Every registered aiding: its Jacobian, and how each registered filter takes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.aiding import REGISTRY, Measurement, Model
from mavins.errors import ConfigError
from mavins.filters import REGISTRY as FILTERS
from mavins.filters import WITHOUT_GRAVITY, FilterState, ImuNoise, RowBlock, make
from mavins.nav import ins
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import (
    BLOCKS,
    CANONICAL_SIZE,
    CORE,
    TAU,
    X_SIZE,
    Layout,
    boxminus,
    boxplus,
)
from mavins.nav.so3 import euler_to_quat
from mavins.types import FloatArray, Origin

FRAME = TangentFrame.at(Origin(math.radians(-33.9), math.radians(151.2), 20.0))
EVERY = Layout.of(BLOCKS).columns
NOISE = ImuNoise(0.015, 0.35, 1e-4, 3e-3, {"b_baro": 0.2, "b_m": 1e-3})
FIELD_N = np.array([0.4, -0.1, 0.9])
SEEDS = range(4)


def model_of(name: str) -> Model:
    module, _, attribute = REGISTRY[name].partition(":")
    model: Model = getattr(import_module(module), attribute)
    return model


def level_turn() -> FloatArray:
    """C_ln some 30 km away from the origin."""
    return FRAME.local_level(FRAME.origin.lat + 4e-3, FRAME.origin.lon - 4e-3)


PARAMETERS: dict[str, Callable[[FloatArray, FloatArray], FloatArray]] = {
    "gnss_velocity": lambda x, u: np.concatenate(
        [level_turn().ravel(), gravity_n(x[:3], FRAME.r0_e, FRAME.C_ne), x[19:20], u, [1.0]]
    ),
    "gnss_position": lambda x, u: x[19:20],
    "heading": lambda x, u: np.concatenate([FRAME.r0_e, FRAME.C_ne.ravel()]),
    "magnetometer": lambda x, u: FIELD_N,
    "zero_rate": lambda x, u: FRAME.w_ie_n,
    "baro": lambda x, u: np.concatenate([FRAME.r0_e, FRAME.C_ne.ravel()]),
    "gravity_tilt": lambda x, u: np.concatenate([FRAME.r0_e, FRAME.C_ne.ravel()]),
    "nonholonomic": lambda x, u: np.array([-1.5, 0.3, 0.6]),
}
"""What a model needs beside the state; a model that is not here needs nothing."""
ROWS = {"gnss_velocity": (2, 3), "heading": (1,), "baro": (1,), "nonholonomic": (2,)}
CASES = [(name, m) for name in REGISTRY for m in ROWS.get(name, (3,))]


def widest(filter_name: str) -> Layout:
    """All the blocks that a filter can take."""
    without = ("g_n",) if filter_name in WITHOUT_GRAVITY else ()
    return Layout.of(block for block in BLOCKS if block not in without)


FILTERED = [
    (name, layout)
    for name in FILTERS
    for layout in (Layout.of(), Layout.of((*CORE, "tau")), widest(name))
]
IDS = [f"{name}-{layout.size}" for name, layout in FILTERED]


def random_case(name: str, m: int, seed: int) -> tuple[FloatArray, ...]:
    """(x, u, z, parameters) at a random place, attitude and motion, with a lever arm."""
    rng = np.random.default_rng(seed)
    x = np.zeros(X_SIZE)
    x[:20] = rng.normal(size=20) * np.repeat([2e3, 10.0, 0.0, 0.02, 0.2, 1.0], [3, 3, 4, 3, 3, 4])
    x[6:10] = euler_to_quat(rng.uniform(-3, 3), rng.uniform(-1.2, 1.2), rng.uniform(-3, 3))
    u = np.concatenate([rng.normal(size=3), rng.normal(size=3) * 4.0 + [0.0, 0.0, -9.8]])
    parameters = PARAMETERS.get(name, lambda x, u: np.empty(0))(x, u)
    noise = 0.01 * rng.normal(size=m)
    x[20:] = rng.normal(size=6) * [1.0, 0.1, 0.1, 0.1, 0.02, 0.02]
    r, _ = model_of(name)(x, u, np.zeros(m), parameters)
    # the measurement is near to what the state predicts, as it is in flight
    return x, u, -r + noise, parameters


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "m"), CASES)
def test_jacobian_is_the_derivative(name: str, m: int, seed: int) -> None:
    x, u, z, parameters = random_case(name, m, seed)
    model = model_of(name)
    r, H = model(x, u, z, parameters)
    assert r.shape == (m,)
    assert H.shape == (m, CANONICAL_SIZE)
    steps = np.repeat(
        [1.0, 1e-2, 1e-5, 1e-4, 1e-3, 1e-2, 1e-3, 1.0, 1e-3, 1e-4], [3, 3, 3, 3, 3, 3, 1, 1, 3, 2]
    )
    numeric = np.empty_like(H)
    for i, h in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            y, d = x.copy(), np.zeros(CANONICAL_SIZE)
            d[i] = sign * h
            boxplus(y, d, EVERY)
            ends.append(model(y, u, z, parameters)[0])
        numeric[:, i] = -(ends[0] - ends[1]) / (2 * h)
    # that the local level frame turns with the place (some 1e-7 rad/m) may be left out
    assert_allclose(H, numeric, atol=1e-6, rtol=1e-7)


@pytest.mark.parametrize("m", [2, 3])
def test_a_weighted_acceleration_is_weighted_in_residual_and_jacobian(m: int) -> None:
    x, u, z, parameters = random_case("gnss_velocity", m, 6)
    whole = model_of("gnss_velocity")(x, u, z, parameters)[1][:, TAU.start]
    parameters[19] = 0.3
    x[19] -= 0.08
    ends = []
    for h in (1e-3, -1e-3):
        y = x.copy()
        y[19] += h
        ends.append(model_of("gnss_velocity")(y, u, z, parameters)[0])
    H = model_of("gnss_velocity")(x, u, z, parameters)[1]
    assert_allclose(H[:, TAU.start], 0.3 * whole)
    assert_allclose(H[:, TAU.start], (ends[1] - ends[0]) / 2e-3, rtol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "m"), [case for case in CASES if case[0].startswith("gnss")])
def test_delay_moves_the_measurement_back_in_time(name: str, m: int, seed: int) -> None:
    """H_tau = -dh/dt along the motion that the IMU reads; the Earth's small rate may be left out."""
    x, u, z, parameters = random_case(name, m, seed)
    model = model_of(name)
    h = 1e-3
    ends = []
    for dt in (h, -h):
        y = x.copy()
        w, f = (tuple(part.tolist()) for part in (u[:3] - x[10:13], u[3:] - x[13:16]))
        phi, dv = ins.increments_from_rates(w, f, w, f, dt)
        ins.mechanize(y, phi, dv, dt, FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n, np.empty((3, 3)))
        ends.append(model(y, u, z, parameters)[0])
    moved = -(ends[0] - ends[1]) / (2 * h)
    assert_allclose(model(x, u, z, parameters)[1][:, TAU.start], -moved, atol=8e-3)


def measurement(name: str, z: FloatArray, R: FloatArray, parameters: FloatArray) -> Measurement:
    rank = list(REGISTRY).index(name)
    return Measurement(name, rank, "", 0, 0, z, R, parameters, model_of(name), 5.0)


@pytest.mark.parametrize(("name", "m"), CASES)
def test_many_states_at_once_give_the_same_residuals(name: str, m: int) -> None:
    x, u, z, parameters = random_case(name, m, 3)
    X = np.stack([x, random_case(name, m, 4)[0]])
    got = measurement(name, z, np.eye(m), parameters).residuals(X, u)
    assert_array_equal(got, [model_of(name)(row, u, z, parameters)[0] for row in X])


@pytest.mark.parametrize("name", REGISTRY)
def test_rank_is_the_place_in_the_registry(name: str) -> None:
    module = import_module(REGISTRY[name].partition(":")[0])
    assert (name, list(REGISTRY).index(name)) == (module.NAME, module.RANK)


def test_a_delay_that_was_believed_wrong_moves_the_antenna_along_its_velocity() -> None:
    x, u, z, parameters = random_case("gnss_position", 3, 2)
    model = model_of("gnss_position")
    r, H = model(x, u, z, parameters)
    late, H_late = model(x, u, z, parameters + 0.05)
    assert_allclose(late, r + 0.05 * H[:, TAU.start])
    assert_allclose(H_late[:, 3:6], 0.05 * np.eye(3))


def state_at(x: FloatArray, u: FloatArray, size: int) -> FilterState:
    rng = np.random.default_rng(size)
    A = rng.normal(size=(size, size))
    scale = np.full(size, 5e-3)
    scale[6:9] = scale[15:19] = scale[20:] = 1e-4
    P = (A @ A.T / size + np.eye(size)) * scale[:, None] * scale
    return FilterState(x, 0.5 * (P + P.T), u, 1_000_000)


def same_as(first_order: FloatArray | float, rel: float = 2e-3) -> Any:
    """What every filter gives to first order, for a covariance so small that the rest does not matter."""
    return pytest.approx(first_order, rel=rel)


@pytest.mark.parametrize(("filter_name", "layout"), FILTERED, ids=IDS)
@pytest.mark.parametrize(("name", "m"), CASES)
def test_every_filter_takes_every_aiding(
    filter_name: str, layout: Layout, name: str, m: int
) -> None:
    x, u, z, parameters = random_case(name, m, 9)
    algorithm = make(filter_name, NOISE, layout)
    state = state_at(x, u, algorithm.layout.size)
    algorithm.adopt(state)
    before = state.copy()
    r, H = model_of(name)(x, u, z, parameters)
    R = np.eye(m) * 1e-3**2
    nis, innovation, covariance = algorithm.update(
        state, measurement(name, z, R, parameters), math.inf
    )
    assert innovation == same_as(r)
    h = H[:, algorithm.layout.columns]
    S = h @ before.P @ h.T + R
    assert nis == same_as(r @ np.linalg.solve(S, r))
    sigma = np.sqrt(np.diag(S))
    assert covariance / np.outer(sigma, sigma) == same_as(S / np.outer(sigma, sigma))
    assert np.trace(state.P) < np.trace(before.P)
    assert_array_equal(state.P, state.P.T)
    assert np.linalg.eigvalsh(state.P)[0] > 0.0
    W = before.P @ h.T
    change = boxminus(state.x, before.x, algorithm.layout.columns)
    expected = W @ np.linalg.solve(S, r)
    assert np.linalg.norm(change - expected) < 2e-3 * np.linalg.norm(expected)
    assert_allclose(state.P, before.P - W @ np.linalg.solve(S, W.T), atol=2e-3 * before.P.max())
    after, _ = model_of(name)(state.x, u, z, parameters)
    assert np.linalg.norm(after) < np.linalg.norm(r)


@pytest.mark.parametrize(("filter_name", "layout"), FILTERED, ids=IDS)
@pytest.mark.parametrize(("name", "m"), CASES)
@pytest.mark.parametrize("why", ["gate", "closed", "nan", "noise"])
def test_what_is_refused_leaves_no_trace(
    filter_name: str, layout: Layout, name: str, m: int, why: str
) -> None:
    x, u, z, parameters = random_case(name, m, 9)
    algorithm = make(filter_name, NOISE, layout)
    state = state_at(x, u, algorithm.layout.size)
    algorithm.adopt(state)
    before = state.copy()
    R = np.eye(m) * 1e-3**2
    gate = {"gate": 1e-9, "closed": 0.0}.get(why, 1e6)
    if why == "nan":
        z[0] = math.nan
    if why == "noise":
        R[0, 0] = -1.0
    nis = algorithm.update(state, measurement(name, z, R, parameters), gate).nis
    assert not nis <= gate
    for now, then in ((state.x, before.x), (state.P, before.P), (state.u, before.u)):
        assert_array_equal(now, then)
    assert state.t_us == before.t_us


@pytest.mark.parametrize("filter_name", FILTERS)
def test_a_filter_that_cannot_take_a_block_says_so(filter_name: str) -> None:
    layout = Layout.of((*CORE, "g_n"))
    if filter_name not in WITHOUT_GRAVITY:
        assert make(filter_name, NOISE, layout).layout.size == 17
        return
    with pytest.raises(ConfigError) as refusal:
        make(filter_name, NOISE, layout)
    assert str(refusal.value) == (
        f"states.gravity: the filter {filter_name} cannot estimate gravity (block g_n); "
        "these can: eskf, iekf, ieskf"
    )


@pytest.mark.parametrize("filter_name", FILTERS)
def test_what_stays_walks_as_it_should(filter_name: str) -> None:
    """Blocks after the core keep their values, and gain the variance of their walks."""
    layout = widest(filter_name)
    algorithm = make(filter_name, NOISE, layout)
    x, u, _, _ = random_case("baro", 1, 5)
    u[:3] *= 0.1
    state = state_at(x, u, layout.size)
    algorithm.adopt(state)
    before = state.copy()
    t_us = np.arange(1, 26) * 4_000 + state.t_us
    frame, rows = FRAME, RowBlock.empty(1, layout.size)
    algorithm.walk(state, frame, t_us, np.tile(u, (25, 1)), int(t_us[-1]), state.t_us, -1, rows)
    assert_array_equal(state.x[16:], before.x[16:])
    further = slice(15, layout.size)
    walked = state.P[further, further] - before.P[further, further]
    variances = NOISE.as_array(layout)[4:] ** 2 * 0.1
    assert np.count_nonzero(variances) == 4
    assert_allclose(walked, np.diag(variances), atol=1e-12)
    assert np.linalg.eigvalsh(state.P)[0] > 0.0
