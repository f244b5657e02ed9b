"""The Euler-angle filter: against the error-state filter, its own update, and the singularity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.aiding import Measurement, gnss_position, heading
from mavins.estimator.estimator import Estimator
from mavins.estimator.settings import HeadingSettings, Settings
from mavins.filters import Filter, FilterSettings, FilterState, ImuNoise, RowBlock, make
from mavins.filters.settings import EulerEkfSettings
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import BLOCKS, CANONICAL_SIZE, X_SIZE, Layout, boxminus
from mavins.nav.linalg import gated_update
from mavins.nav.so3 import euler_jacobian, euler_to_quat, quat_to_dcm, quat_to_euler
from mavins.types import FloatArray, GnssFix, HeadingFix, Health, ImuTable, Origin

ORIGIN = Origin(math.radians(47.4), math.radians(8.5), 488.0)
FRAME = TangentFrame.at(ORIGIN)
NOISE = ImuNoise(0.015, 0.35, 1e-4, 3e-3)
PRIOR = np.repeat([1.0, 0.3, 0.05, 0.01, 0.2], 3) ** 2
GRAVITY = gravity_n(np.zeros(3), FRAME.r0_e, FRAME.C_ne)


def flying(seed: int = 0, size: int = 15) -> FilterState:
    """A state at a random attitude with correlated errors."""
    rng = np.random.default_rng(seed)
    x = np.zeros(X_SIZE)
    x[3:6] = rng.normal(size=3) * 10.0
    x[6:10] = euler_to_quat(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-3, 3))
    x[10:16] = rng.normal(size=6) * 0.01
    scale = np.sqrt(np.concatenate([PRIOR, np.full(CANONICAL_SIZE - 15, 0.1)])[:size])
    A = rng.normal(size=(size, size))
    P = (A @ A.T / size + np.eye(size)) * scale[:, None] * scale
    u = np.concatenate([rng.normal(size=3) * 0.3, -quat_to_dcm(x[6:10]).T @ GRAVITY])
    return FilterState(x, 0.5 * (P + P.T), u, 0)


def readings(u: FloatArray, n: int, dt: float) -> FloatArray:
    """A manoeuvre (n, 6) around the reading u."""
    s = np.arange(1, n + 1)[:, None] * dt
    swing = np.hstack([0.5 * np.sin(s * [2.0, 1.7, 1.1]), 2.0 * np.sin(s * [0.9, 1.9, 2.9])])
    return u + swing


def walk(algorithm: Filter, state: FilterState, imu: FloatArray, dt_us: int) -> None:
    t = np.arange(1, len(imu) + 1) * dt_us + state.t_us
    algorithm.walk(state, FRAME, t, imu, int(t[-1]), state.t_us, -1, RowBlock.empty(1))


def test_it_goes_where_the_error_state_filter_goes() -> None:
    euler, strapdown = flying(), flying()
    imu = readings(euler.u, 500, 0.004)
    walk(make("euler_ekf", NOISE), euler, imu, 4_000)
    walk(make("eskf", NOISE), strapdown, imu, 4_000)
    d = boxminus(euler.x, strapdown.x, Layout.of().columns)
    assert np.abs(d[:3]).max() < 1e-4
    assert np.abs(d[3:6]).max() < 1e-4
    assert np.abs(d[6:9]).max() < 2e-6
    sigma = np.sqrt(np.diag(strapdown.P))
    assert np.abs((euler.P - strapdown.P) / sigma / sigma[:, None]).max() < 2e-3
    assert_array_equal(euler.P, euler.P.T)


def test_a_walk_does_not_depend_on_its_slices() -> None:
    algorithm, whole, sliced = make("euler_ekf", NOISE), flying(3), flying(3)
    imu = readings(whole.u, 200, 0.004)
    walk(algorithm, whole, imu, 4_000)
    for part in np.array_split(imu, [1, 2, 40, 90]):
        walk(algorithm, sliced, part, 4_000)
    assert_array_equal(sliced.x, whole.x)
    assert_array_equal(sliced.P, whole.P)


def test_a_filter_of_more_states_leaves_the_common_ones_alike() -> None:
    few, many = flying(2), flying(2, 23)
    many.x[:], many.u[:] = few.x, few.u
    imu = readings(few.u, 50, 0.004)
    many.P = np.eye(23) * 1e-18
    many.P[:15, :15] = few.P
    for layout, state in ((Layout.of(), few), (Layout.of(list(BLOCKS)[:-1]), many)):
        algorithm = make("euler_ekf", NOISE, layout)
        walk(algorithm, state, imu, 4_000)
        algorithm.update(state, position(np.ones(3), 1.0), math.inf)
    assert_allclose(many.x[:16], few.x[:16], atol=1e-12)
    assert_allclose(many.P[:15, :15], few.P, rtol=1e-9, atol=1e-12)


def position(z: FloatArray, sigma: float) -> Measurement:
    R = np.eye(3) * sigma**2
    return Measurement(gnss_position.NAME, 0, "", 0, 0, z, R, np.empty(0), gnss_position.model, 5.0)


def test_corrections_are_added_to_the_angles() -> None:
    """Covariance and gain of the angles themselves, made by their kinematic matrix, give the same update."""
    algorithm, state = make("euler_ekf", NOISE), flying(5)
    before = state.copy()
    measurement = position(before.x[:3] + np.array([0.4, -0.3, 0.2]), 0.1)
    algorithm.update(state, measurement, math.inf)
    r, H = measurement.linearize(before.x, before.u)
    angles = quat_to_euler(before.x[6:10])
    T = np.eye(15)
    T[6:9, 6:9] = np.linalg.inv(euler_jacobian(angles[0], angles[1]))
    own = np.linalg.inv(T) @ before.P @ np.linalg.inv(T).T
    d, columns = np.empty(15), Layout.of().columns
    gated_update(
        own,
        r,
        np.pad(H[:, :15] @ T, ((0, 0), (0, 4))),
        measurement.R,
        columns,
        1e9,
        d,
        np.empty((3, 3)),
    )
    after = quat_to_euler(state.x[6:10])
    assert_allclose(after, angles + d[6:9], atol=1e-12)
    assert_allclose(state.x[:6], before.x[:6] + d[:6], atol=1e-12)
    assert_allclose(state.x[10:16], before.x[10:16] + d[9:15], atol=1e-12)
    T[6:9, 6:9] = np.linalg.inv(euler_jacobian(after[0], after[1]))
    assert_allclose(state.P, T @ own @ T.T, atol=1e-12)


def test_yaw_is_wrapped() -> None:
    algorithm, state = make("euler_ekf", NOISE), flying()
    state.x[6:10] = euler_to_quat(0.1, 0.2, math.radians(179.0))
    place = np.concatenate([FRAME.r0_e, FRAME.C_ne.ravel()])
    z, R = np.array([math.radians(-177.0)]), np.eye(1) * 1e-8
    algorithm.update(
        state, Measurement(heading.NAME, 2, "", 0, 0, z, R, place, heading.model, 5.0), math.inf
    )
    assert quat_to_euler(state.x[6:10])[2] == pytest.approx(math.radians(-177.0), abs=1e-4)


@pytest.mark.parametrize("up", [1.0, -1.0])
@pytest.mark.parametrize("compat", [False, True])
def test_straight_up_it_stops_and_says_so(up: float, compat: bool) -> None:
    settings = FilterSettings(euler_ekf=EulerEkfSettings(compat))
    algorithm, state = make("euler_ekf", NOISE, settings=settings), flying()
    state.x[6:16] = 0.0
    state.x[6] = 1.0
    state.u = np.concatenate([[0.0, up * 2.0, 0.0], -GRAVITY])
    imu = np.tile(state.u, (200, 1))
    assert not algorithm.complaint(state)
    walk(algorithm, state, imu[:50], 10_000)
    assert not algorithm.complaint(state)
    walk(algorithm, state, imu, 10_000)
    assert "singular" in algorithm.complaint(state)
    held = state.copy()
    walk(algorithm, state, imu, 10_000)
    outcome = algorithm.update(state, position(np.zeros(3), 1.0), math.inf)
    assert math.isnan(outcome.nis)
    assert np.all(np.isfinite(outcome.sigma))
    assert_array_equal(state.x, held.x)
    assert_array_equal(state.P, held.P)
    assert np.all(np.isfinite(state.x))
    assert np.all(np.isfinite(state.P))


@pytest.mark.parametrize("pitch_deg", [80.0, 86.9, -86.9])
def test_near_the_singularity_nothing_becomes_nan(pitch_deg: float) -> None:
    algorithm = make("euler_ekf", NOISE)
    rng = np.random.default_rng(1)
    for _ in range(20):
        state = flying()
        state.x[6:10] = euler_to_quat(rng.uniform(-3, 3), math.radians(pitch_deg), 1.0)
        imu = np.hstack([rng.normal(size=(5, 3)) * 20.0, rng.normal(size=(5, 3)) * 50.0])
        walk(algorithm, state, imu, 100_000)
        assert np.all(np.isfinite(state.x))
        assert np.all(np.isfinite(state.P))


def climb(estimator: Estimator, slices: int) -> list[tuple[Health, str, int]]:
    """Level at 10 m/s, pitched up to 90 deg for two seconds, level again; health after each 0.1 s."""
    pitch = np.concatenate(
        [np.zeros(600), np.linspace(0, 0.5 * np.pi, 150), np.full(200, 0.5 * np.pi)]
    )
    pitch = np.concatenate([pitch, np.linspace(0.5 * np.pi, 0.0, 150), np.zeros(900)])
    rate = np.gradient(pitch, 0.01)
    t = np.arange(len(pitch)) * 10_000 + 1_000_000
    gyro = np.column_stack([0 * rate, rate, 0 * rate])
    # body to n is a rotation about east by the pitch
    f = -GRAVITY[2] * np.column_stack([-np.sin(pitch), 0 * pitch, np.cos(pitch)])
    seen = []
    for start in range(0, len(t), 10):
        for part in np.array_split(np.arange(start, start + 10), slices):
            estimator.feed_imu(ImuTable(t[part], f[part], gyro[part]))
        now = int(t[start + 9])
        lat = ORIGIN.lat + 10.0 * (now - 1_000_000) * 1e-6 / 6.38e6
        estimator.feed_heading(HeadingFix(now, 0.0, source="mag"))
        estimator.feed_gnss(GnssFix(now, lat, ORIGIN.lon, 488.0, (10.0, 0.0, 0.0), 3, source="gps"))
        seen.append((estimator.health, estimator.reason, estimator.reset_counter))
    return seen


@pytest.mark.jit
def test_the_estimator_gives_up_straight_up_and_starts_anew() -> None:
    settings = Settings(heading=HeadingSettings(sigma_deg=3.0))
    seen = climb(Estimator(settings, "euler_ekf"), 1)
    states = [health for health, _, _ in seen]
    assert Health.RUNNING in states[:60]
    lost = states.index(Health.DIVERGED)
    assert 65 < lost < 80
    assert "singular" in seen[lost][1]
    assert states[-1] is Health.RUNNING
    assert seen[-1][2] > seen[0][2]
    assert seen == climb(Estimator(settings, "euler_ekf"), 10)
