"""The error-state filter: a million steps, gaps, and the way from a correction to the state."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.aiding import Measurement, gnss_position, heading
from mavins.filters import FilterSettings, FilterState, ImuNoise, RowBlock, make
from mavins.filters.eskf import Eskf
from mavins.filters.walking import GAP_NOISE
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import BLOCKS, CANONICAL_SIZE, X_SIZE, Layout
from mavins.types import FloatArray, Origin

FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
NOISE = ImuNoise(0.015, 0.35, 1e-4, 3e-3)
PRIOR = np.repeat([1.0, 0.3, 0.05, 0.01, 0.2], 3) ** 2


def standing() -> FilterState:
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    u = np.concatenate([FRAME.w_ie_n, -gravity_n(np.zeros(3), FRAME.r0_e, FRAME.C_ne)])
    return FilterState(x, np.diag(PRIOR), u, 0)


def filter_of(noise: ImuNoise, layout: Layout | None = None) -> Eskf:
    return Eskf(noise, layout or Layout.of(), FilterSettings())


def walk(
    algorithm: Eskf, state: FilterState, t_us: list[int], imu: FloatArray, grid_us: int = -1
) -> RowBlock:
    rows = RowBlock.empty(len(t_us))
    algorithm.walk(state, FRAME, np.array(t_us), imu, t_us[-1], state.t_us, grid_us, rows)
    return rows


def observation(
    aiding: Any, z: FloatArray, R: FloatArray, parameters: FloatArray | None = None
) -> Measurement:
    parameters = np.empty(0) if parameters is None else parameters
    return Measurement(aiding.NAME, aiding.RANK, "", 0, 0, z, R, parameters, aiding.model, 5.0)


def assert_covariance(P: FloatArray) -> None:
    assert_array_equal(P, P.T)
    scale = 1.0 / np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P * scale[:, None] * scale)[0] > 1e-12


@pytest.mark.jit
@pytest.mark.parametrize("noise", [NOISE, ImuNoise(1e-5, 1e-4, 0.0, 0.0)], ids=["rough", "fine"])
def test_covariance_after_a_million_steps(noise: ImuNoise) -> None:
    """Tight GNSS and heading against a vague or a precise IMU, over more than an hour at 250 Hz."""
    rng = np.random.default_rng(8)
    algorithm = filter_of(noise)
    state = standing()
    quiet = state.u.copy()
    steps, run = 1_000_000, 250
    R = np.eye(3) * 0.02**2
    place = np.concatenate([FRAME.r0_e, FRAME.C_ne.ravel()])
    t = np.arange(1, run + 1) * 4000
    rows = RowBlock.empty(1)
    shake = np.repeat([0.3, 3.0], 3) * rng.normal(size=(run, 6))
    shake -= shake.mean(axis=0)
    for k in range(steps // run):
        stamps = state.t_us + t
        until = int(stamps[-1])
        algorithm.walk(state, FRAME, stamps, quiet + shake, until, state.t_us, -1, rows)
        z = rng.normal(size=3) * 0.02
        algorithm.update(state, observation(gnss_position, z, R), math.inf)
        algorithm.update(
            state, observation(heading, np.zeros(1), np.eye(1) * 1e-4, place), math.inf
        )
        if k % 400 == 0:
            assert_covariance(state.P)
    assert state.t_us == steps * 4000
    assert_covariance(state.P)
    assert np.all(np.isfinite(state.x))
    assert abs(np.linalg.norm(state.x[6:10]) - 1.0) < 1e-14
    assert np.linalg.norm(state.x[:3]) < 0.5


def test_a_standing_vehicle_stays_where_it_is() -> None:
    state = standing()
    walk(filter_of(NOISE), state, [10_000 * k for k in range(1, 1001)], np.tile(state.u, (1000, 1)))
    assert np.linalg.norm(state.x[:3]) < 1e-6
    assert np.linalg.norm(state.x[3:6]) < 1e-6
    assert_allclose(state.x[6:10], [1, 0, 0, 0], atol=1e-9)


def test_biases_are_taken_off_the_readings() -> None:
    clean, biased = standing(), standing()
    biased.x[10:13], biased.x[13:16] = [0.01, -0.02, 0.03], [0.1, 0.2, -0.3]
    t = [10_000 * k for k in range(1, 101)]
    imu = np.tile(clean.u + np.array([0.1, 0.2, 0.3, 0.5, 1.0, 0.3]), (100, 1))
    clean.u = imu[0].copy()
    biased.u = imu[0] + biased.x[10:16]
    walk(filter_of(NOISE), clean, t, imu)
    walk(filter_of(NOISE), biased, t, imu + biased.x[10:16])
    assert_allclose(biased.x[:10], clean.x[:10], atol=1e-11)


@pytest.mark.parametrize(("gap_us", "held"), [(200_000, False), (201_000, True), (2_000_000, True)])
def test_across_a_gap_readings_are_joined_or_held(gap_us: int, held: bool) -> None:
    state = standing()
    row = state.u.copy()
    row[3] += 1.0
    walk(filter_of(NOISE), state, [gap_us], row[np.newaxis])
    dt = gap_us * 1e-6
    assert state.x[3] == pytest.approx(0.0 if held else 0.5 * dt, abs=1e-5)
    assert_array_equal(state.u, row)
    noise = NOISE.accel * (GAP_NOISE if held else 1.0)
    expected = PRIOR[3] + noise**2 * dt + (dt * 0.2) ** 2 + (9.8 * dt) ** 2 * PRIOR[7]
    tolerance = 0.05 if dt < 1.0 else 0.3
    assert state.P[3, 3] == pytest.approx(expected, rel=tolerance)


def test_a_walk_does_not_depend_on_its_slices() -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.integers(1000, 9000, 300)).tolist()
    whole, sliced = standing(), standing()
    imu = whole.u + rng.normal(size=(300, 6))
    algorithm = filter_of(NOISE)
    all_rows = walk(algorithm, whole, t, imu, 20_000)
    got = []
    for part in np.array_split(np.arange(300), [1, 2, 40, 41, 200]):
        before = sliced.t_us
        rows = RowBlock.empty(300)
        stamps = np.array(t)[part]
        until = int(stamps[-1])
        algorithm.walk(sliced, FRAME, stamps, imu[part], until, before, 20_000, rows)
        got.extend(rows.t_us[: rows.count].tolist())
    assert got == all_rows.t_us[: all_rows.count].tolist()
    assert_array_equal(sliced.x, whole.x)
    assert_array_equal(sliced.P, whole.P)


def test_rows_are_at_the_first_stamp_of_each_grid_cell() -> None:
    state = standing()
    t = [3_000, 19_000, 21_000, 39_000, 40_000, 95_000]
    rows = walk(filter_of(NOISE), state, t, np.tile(state.u, (6, 1)), 20_000)
    assert rows.t_us[: rows.count].tolist() == [21_000, 40_000, 95_000]


def test_an_instant_between_rows_is_reached_along_the_line() -> None:
    algorithm, direct, stopped = filter_of(NOISE), standing(), standing()
    row = direct.u + np.array([0.02, 0.01, 0.0, 0.5, 0.0, 0.2])
    walk(algorithm, direct, [10_000], row[np.newaxis])
    halfway = stopped.u + 0.4 * (row - stopped.u)
    rows = RowBlock.empty(1)
    algorithm.walk(stopped, FRAME, np.array([10_000]), row[np.newaxis], 4_000, 0, -1, rows)
    assert rows.count == 0
    assert stopped.t_us == 4_000
    assert_array_equal(stopped.u, halfway)
    walk(algorithm, stopped, [10_000], row[np.newaxis])
    assert_allclose(stopped.x[:10], direct.x[:10], atol=5e-6)
    assert_allclose(stopped.P, direct.P, atol=1e-6)


def test_a_correction_goes_into_the_state_and_the_error_is_zero_again() -> None:
    algorithm, state = filter_of(NOISE), standing()
    state.P[6:9, 0:3] = state.P[0:3, 6:9] = 0.03 * np.eye(3)
    z = np.array([1.0, 0.0, 0.0])
    nis, innovation, S = algorithm.update(state, observation(gnss_position, z, np.eye(3)), 100.0)
    assert_array_equal(innovation, z)
    assert nis == pytest.approx(0.5)
    assert_allclose(S, 2.0 * np.eye(3), atol=1e-12)
    assert_allclose(state.x[:3], [0.5, 0, 0], atol=1e-12)
    # theta = 0.015 rad about x
    assert state.x[7] == pytest.approx(math.sin(0.0075))
    assert_covariance(state.P)


def test_a_filter_of_more_states_leaves_the_common_ones_alike() -> None:
    few, many = filter_of(NOISE), filter_of(NOISE, Layout.of(BLOCKS))
    a, b = standing(), standing()
    b.P = np.eye(CANONICAL_SIZE) * 1e-18
    b.P[:15, :15] = a.P
    t = [4_000 * k for k in range(1, 51)]
    imu = a.u + np.random.default_rng(1).normal(size=(50, 6)) * 0.1
    for algorithm, state in ((few, a), (many, b)):
        walk(algorithm, state, t, imu)
        algorithm.update(state, observation(gnss_position, np.ones(3), np.eye(3)), 1e9)
    assert_allclose(b.x[:16], a.x[:16], atol=1e-12)
    assert_allclose(b.P[:15, :15], a.P, rtol=1e-9, atol=1e-12)


def test_copies_share_nothing() -> None:
    state = standing()
    copy = state.copy()
    for field in dataclasses.fields(FilterState):
        if field.name != "t_us":
            assert not np.shares_memory(getattr(state, field.name), getattr(copy, field.name))


def test_made_by_name() -> None:
    assert isinstance(make("eskf", NOISE), Eskf)
