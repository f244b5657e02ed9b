"""The first attitude: exact where the data are, and a covariance that is as large as the errors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.estimator.alignment import Start, initial_state, level
from mavins.estimator.compass import levelled
from mavins.nav.layout import CORE, X_SIZE, Layout, boxminus
from mavins.nav.s2 import tilted
from mavins.nav.so3 import euler_to_quat, quat_to_dcm, quat_to_euler
from mavins.types import FloatArray

GRAVITY = np.array([0.0, 0.0, -9.81])
RNG = np.random.default_rng(21)
ATTITUDES = [
    np.zeros(3),
    np.array([3.0, 0.1, -2.0]),
    *RNG.uniform([-3.1, -1.4, -3.1], [3.1, 1.4, 3.1], (20, 3)),
]


@pytest.mark.parametrize("euler", ATTITUDES)
def test_a_standing_vehicle_is_levelled_exactly(euler: FloatArray) -> None:
    q = euler_to_quat(*euler)
    f_b = quat_to_dcm(q).T @ GRAVITY
    assert_allclose(quat_to_dcm(level(f_b, GRAVITY, euler[2])), quat_to_dcm(q), atol=1e-12)


@pytest.mark.parametrize("euler", ATTITUDES[:1] + ATTITUDES[2:])
def test_an_accelerating_vehicle_is_levelled_exactly(euler: FloatArray) -> None:
    # of both pitches that explain the force, the one nearer to level is taken: the true one is not far from it
    euler = euler * [1.0, 0.5, 1.0]
    push = GRAVITY + RNG.normal(size=3) * [1.5, 1.5, 0.5]
    q = euler_to_quat(*euler)
    f_b = quat_to_dcm(q).T @ push
    assert_allclose(quat_to_dcm(level(f_b, push, euler[2])), quat_to_dcm(q), atol=1e-12)


def test_the_size_of_the_force_does_not_matter() -> None:
    q = euler_to_quat(0.2, -0.3, 1.0)
    f_b = 1.07 * (quat_to_dcm(q).T @ GRAVITY)
    assert_allclose(quat_to_dcm(level(f_b, GRAVITY, 1.0)), quat_to_dcm(q), atol=1e-12)


def test_a_force_that_no_pitch_explains_gives_the_nearest() -> None:
    q = level(np.array([9.81, 0.0, 0.0]), GRAVITY, 0.0)
    assert_allclose(abs(quat_to_euler(q)[1]), math.pi / 2, atol=1e-6)
    assert np.all(np.isfinite(level(np.array([9.0, 1e-9, 0.0]), GRAVITY + np.eye(3)[0] * 3.0, 0.3)))


def start(euler: FloatArray, accel_b: FloatArray, yaw: float) -> Start:
    return Start(
        accel_b=accel_b,
        push_n=GRAVITY,
        yaw_n=yaw,
        p_n=np.array([1.0, 2.0, 3.0]),
        R_p=np.diag([0.5, 0.5, 0.8]) ** 2,
        v_n=np.array([0.1, 0.2, 0.3]),
        R_v=np.eye(3) * 0.1**2,
        b_g=np.array([0.01, 0.0, -0.01]),
        sigma_b_g=0.01,
        sigma_b_a=0.05,
        sigma_tilt=2e-3,
        sigma_yaw=0.03,
        lever_b=np.array([0.2, 0.0, -0.1]),
        sigma_lever=0.3,
        delay=0.12,
        sigma_delay=0.05,
    )


@pytest.mark.parametrize(
    "euler", [np.zeros(3), np.array([0.3, -0.4, 2.0]), np.array([-0.9, 0.7, -1.0])]
)
def test_initial_covariance_is_that_of_the_errors(euler: FloatArray) -> None:
    rng = np.random.default_rng(4)
    runs = 4000
    q = euler_to_quat(*euler)
    f_b = quat_to_dcm(q).T @ GRAVITY
    truth = np.zeros(X_SIZE)
    truth[6:10] = q
    columns = Layout.of().columns
    errors = np.empty((runs, 15))
    for k in range(runs):
        b_a = rng.normal(size=3) * 0.05
        noise = rng.normal(size=3) * 2e-3 * 9.81
        s = start(euler, f_b + b_a + noise, euler[2] + 0.03 * rng.normal())
        x, P = initial_state(s, Layout.of())
        truth[13:16] = b_a
        errors[k] = boxminus(truth, x, columns)
    found = np.cov(errors[:, [6, 7, 8, 12, 13, 14]].T)
    _, P = initial_state(start(euler, f_b, euler[2]), Layout.of())
    expected = P[np.ix_([6, 7, 8, 12, 13, 14], [6, 7, 8, 12, 13, 14])]
    scale = np.sqrt(np.diag(expected))
    # 4 sigmas of a sampled correlation, and what tilts of a few mrad leave to the second order
    assert_allclose(found / scale / scale[:, None], expected / scale / scale[:, None], atol=0.08)


def test_the_first_state_is_what_was_measured() -> None:
    euler = np.array([0.1, 0.2, 0.3])
    s = start(euler, quat_to_dcm(euler_to_quat(*euler)).T @ GRAVITY, 0.3)
    x, P = initial_state(s, Layout.of())
    C = quat_to_dcm(x[6:10])
    assert_allclose(x[:3] + C @ s.lever_b, s.p_n)
    assert_allclose(x[3:6], s.v_n)
    assert_allclose(x[10:13], s.b_g)
    assert_allclose(x[16:19], s.lever_b)
    assert_allclose(np.diag(P)[:3], [0.25, 0.25, 0.64])
    assert_allclose(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_further_states_start_where_they_are_told() -> None:
    s = start(np.zeros(3), -GRAVITY, 0.4)
    core, P = initial_state(s, Layout.of())
    x, wide = initial_state(s, Layout.of((*CORE, "l_b", "tau")))
    assert_allclose(x, core)
    assert_allclose(x[16:20], [0.2, 0.0, -0.1, 0.12])
    assert not x[20:].any()
    assert_allclose(np.sqrt(np.diag(wide)[15:]), [0.3, 0.3, 0.3, 0.05])
    # the antenna is as well known as before, wherever the IMU is beside it
    H = np.hstack([np.eye(3), quat_to_dcm(x[6:10])])
    at = np.r_[0:3, 15:18]
    assert_allclose(H @ wide[np.ix_(at, at)] @ H.T, P[:3, :3], atol=1e-12)


def test_an_attitude_levelled_along_gravity_is_off_by_its_tilt() -> None:
    euler, d = np.array([0.3, -0.4, 2.0]), np.array([3e-4, -5e-4])
    leaning = np.array(tilted((d[0], d[1]), (0.0, 0.0, -9.81)))
    layout = Layout.of((*CORE, "g_n"))
    C_t = quat_to_dcm(euler_to_quat(*euler))
    s = dataclasses.replace(start(euler, C_t.T @ leaning, euler[2]), sigma_gravity=0.01)
    x, P = initial_state(s, layout)
    truth = np.zeros(X_SIZE)
    truth[6:10] = euler_to_quat(*euler)
    theta = boxminus(truth, x, layout.columns)[6:9]
    assert_allclose(P[6:9, 15:] @ d / 0.01**2, theta, atol=1e-6)
    _, without = initial_state(s, Layout.of())
    assert_allclose(
        P[6:9, 6:9] - without[6:9, 6:9], P[6:9, 15:] @ P[15:, 6:9] / 0.01**2, atol=1e-15
    )


def test_a_yaw_found_from_the_field_is_off_by_its_bias() -> None:
    euler, b_m = np.array([0.1, 0.2, 0.5]), np.array([2e-4, -3e-4, 1e-4])
    C = quat_to_dcm(euler_to_quat(*euler))
    m = np.array([0.5, 0.1, 0.8])
    f_b = C.T @ GRAVITY
    yaw, _ = levelled(C.T @ m + b_m, f_b, GRAVITY, m)
    by_mag = np.array([m[1], -m[0], 0.0]) / (m[0] ** 2 + m[1] ** 2)
    layout = Layout.of((*CORE, "b_m"))
    s = dataclasses.replace(start(euler, f_b, yaw), sigma_mag=0.05, yaw_by_mag=by_mag)
    x, P = initial_state(s, layout)
    truth = np.zeros(X_SIZE)
    truth[6:10] = euler_to_quat(*euler)
    theta = boxminus(truth, x, layout.columns)[6:9]
    assert np.linalg.norm(theta) > 3e-4
    assert_allclose(P[6:9, 15:] @ b_m / 0.05**2, theta, atol=2e-6)
