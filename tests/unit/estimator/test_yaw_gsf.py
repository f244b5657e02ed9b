"""The Gaussian sum alone, on the motion of a vehicle that is known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.estimator.yaw_gsf import (
    HYPOTHESES,
    OUTLIER,
    STATES,
    advance,
    fuse,
    innovate,
    moments,
    predict,
    spread,
)
from mavins.nav.so3 import euler_to_quat, quat_to_dcm, quat_to_euler
from mavins.types import FloatArray

Q = np.array([1e-4, 1e-6, 1e-6])
Filters = tuple[FloatArray, FloatArray, FloatArray]


def begun(sigma: float = 0.1) -> Filters:
    x, P = np.empty((HYPOTHESES, STATES)), np.empty((HYPOTHESES, STATES, STATES))
    log_w = np.empty(HYPOTHESES)
    spread(x, P, log_w, np.zeros(2), sigma)
    return x, P, log_w


def flown(yaw: float, push: float, seed: int = 0, tilt: float = 0.0) -> tuple[Filters, FloatArray]:
    """Filters and q_hb after 10 s of accelerations of the size `push` to all sides, h turned by -yaw from north and
    tilted."""
    rng = np.random.default_rng(seed)
    filters = begun()
    q_hb = euler_to_quat(tilt, 0.0, 0.0)
    c, s = math.cos(yaw), math.sin(yaw)
    v = np.zeros(2)
    for k in range(50):
        a = push * np.array([math.cos(0.3 * k), math.sin(0.2 * k)])
        v += 0.2 * a
        level_h = np.array([c * a[0] + s * a[1], -s * a[0] + c * a[1], -9.81])
        # the body is level: what the tilted frame makes of its specific force
        force_h = 0.2 * quat_to_dcm(q_hb) @ level_h
        z = v + rng.normal(size=2) * 0.1
        fuse(*filters, q_hb, force_h, Q, z, 0.1**2, np.zeros(2))
    return filters, q_hb


@pytest.mark.parametrize("yaw", [0.1, 1.5, 3.1, -2.0, -0.4])
def test_accelerations_show_the_yaw(yaw: float) -> None:
    filters, _ = flown(yaw, 2.0)
    psi, sigma, _ = moments(*filters)
    assert sigma < math.radians(3.0)
    assert abs(math.remainder(psi - yaw, 2.0 * math.pi)) < 3.0 * sigma


def test_a_hover_shows_none() -> None:
    filters, _ = flown(0.7, 0.0)
    assert moments(*filters)[1] > math.radians(60.0)


def test_a_tilt_is_found_on_the_way() -> None:
    _, q_hb = flown(0.7, 1.0, tilt=0.08)
    assert_allclose(quat_to_euler(q_hb)[:2], 0.0, atol=0.02)


def test_a_velocity_that_nobody_believes_is_left_out() -> None:
    filters, q_hb = flown(0.7, 2.0)
    x, P, log_w = (part.copy() for part in filters)
    force_h = np.array([0.0, 0.0, -1.962])
    nis = fuse(*filters, q_hb, force_h, Q, np.array([90.0, 0.0]), 0.01, np.zeros(2))
    assert nis > OUTLIER
    for k in range(HYPOTHESES):
        predict(x[k], P[k], force_h, Q)
    assert_array_equal(filters[0], x)
    assert_array_equal(filters[2], log_w)


def test_the_prediction_s_jacobian() -> None:
    force_h = np.array([400.0, -300.0, -2.0])  # far above its noise: its share is one
    x = np.array([1.0, -2.0, 0.7, 0.02, -0.01])
    root = np.random.default_rng(2).normal(size=(STATES, STATES)) * 1e-3
    P = root @ root.T
    F = np.empty((STATES, STATES))
    for j in range(STATES):
        ends = []
        for step in (1e-6, -1e-6):
            moved = x.copy()
            moved[j] += step
            predict(moved, P.copy(), force_h, np.zeros(3))
            ends.append(moved)
        F[:, j] = (ends[0] - ends[1]) / 2e-6
    after = P.copy()
    predict(x.copy(), after, force_h, np.zeros(3))
    assert_allclose(after, F @ P @ F.T, rtol=1e-6, atol=1e-9)


def test_an_update_is_a_kalman_update_with_a_lever() -> None:
    root = np.random.default_rng(3).normal(size=(STATES, STATES))
    P, x = root @ root.T, np.array([1.0, 2.0, 0.5, 0.0, 0.1])
    lever_h, z, R = np.array([0.6, -0.2]), np.array([1.4, 2.5]), 0.3
    c, s = math.cos(x[2]), math.sin(x[2])
    turned = np.array([[c, -s], [s, c]]) @ lever_h
    H = np.array([[1.0, 0.0, -turned[1], 0.0, 0.0], [0.0, 1.0, turned[0], 0.0, 0.0]])
    S = H @ P @ H.T + R * np.eye(2)
    r = z - x[:2] - turned
    expected = x + P @ H.T @ np.linalg.solve(S, r)
    out = np.empty(22)
    innovate(x, P, z, R, lever_h, out)
    assert_allclose(x, expected)
    assert_allclose(out[20:], [r @ np.linalg.solve(S, r), math.log(np.linalg.det(S))])


def test_the_way_does_not_depend_on_where_it_is_cut() -> None:
    rng = np.random.default_rng(4)
    t_us = np.arange(1, 41, dtype=np.int64) * 5_000
    imu = rng.normal(size=(40, 6)) + np.array([0.2, 0.0, 0.5, 0.0, 0.0, -9.8])
    ways = []
    for cuts in ([40], [1, 7, 22, 40]):
        q, force, u = euler_to_quat(0.1, 0.2, 0.3), np.zeros(3), imu[0].copy()
        first = t0 = 0
        for end in cuts:
            until = int(t_us[end - 1])
            advance(q, force, u, np.full(3, 0.01), t0, t_us[first:end], imu[first:end], until)
            first, t0 = end, until
        ways.append(np.concatenate([q, force, u]))
    assert_array_equal(ways[0], ways[1])


def test_a_turn_is_followed_between_rows() -> None:
    t_us = np.arange(1, 101, dtype=np.int64) * 10_000
    imu = np.tile([0.0, 0.0, 1.0, 1.0, 0.0, -9.8], (100, 1))
    q, force = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    advance(q, force, imu[0].copy(), np.zeros(3), 0, t_us[:56], imu[:56], 555_000)
    assert quat_to_euler(q)[2] == pytest.approx(0.555, abs=1e-9)
    # 1 m/s^2 forward while turning at 1 rad/s
    assert_allclose(force, [math.sin(0.555), 1.0 - math.cos(0.555), -9.8 * 0.555], rtol=1e-4)
