"""From a fix to a measurement: place, axes, noise and what is missing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.aiding import (
    REGISTRY,
    baro,
    gnss_position,
    gnss_velocity,
    gravity_tilt,
    heading,
    magnetometer,
    nonholonomic,
    zero_rate,
    zero_velocity,
)
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import BLOCKS, X_SIZE, Layout, boxplus
from mavins.nav.so3 import dcm_to_quat, euler_to_quat, quat_mul, quat_to_dcm
from mavins.types import GnssFix, HeadingFix, Origin

FRAME = TangentFrame.at(Origin(0.8, 0.15, 500.0))
U = np.array([0.1, -0.2, 0.3, 0.0, 0.0, -9.8])


def fix(v_l: tuple[float, float, float] | None) -> GnssFix:
    return GnssFix(5_000_000, 0.83, 0.2, 900.0, v_l, 3, source="gps")


def state(yaw: float = 0.0) -> np.ndarray:
    x = np.zeros(X_SIZE)
    x[6:10] = euler_to_quat(0.0, 0.0, yaw)
    return x


def test_ranks_order_the_measurements_of_one_instant() -> None:
    modules = (
        gnss_position,
        gnss_velocity,
        heading,
        zero_velocity,
        magnetometer,
        zero_rate,
        baro,
        gravity_tilt,
        nonholonomic,
    )
    assert [m.RANK for m in modules] == list(range(len(modules)))
    assert sorted(m.NAME for m in modules) == sorted(REGISTRY)


def test_position_is_where_the_fix_is_and_its_noise_is_level_there() -> None:
    m = gnss_position.measure(fix(None), 4_900_000, FRAME, 0.5, 2.0, 5.0)
    assert (m.stamp_us, m.t_us, m.source, m.quality) == (5_000_000, 4_900_000, "gps", "")
    assert_allclose(FRAME.to_lla(m.z), [0.83, 0.2, 900.0], rtol=1e-11)
    C_ln = FRAME.local_level(0.83, 0.2)
    assert_allclose(C_ln @ m.R @ C_ln.T, np.diag([0.25, 0.25, 4.0]), atol=1e-12)
    assert np.array_equal(m.R, m.R.T)


def test_position_is_the_antenna_s() -> None:
    m = gnss_position.measure(fix(None), 0, FRAME, 0.5, 2.0, 5.0)
    x = state(math.pi / 2)
    x[16:19] = [1.0, 0.0, -0.5]
    x[:3] = m.z - [0.0, 1.0, -0.5]
    r, _ = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-9)


def test_velocity_has_the_rows_that_are_measured() -> None:
    for v_l, rows in (((1.0, 2.0, 3.0), 3), ((1.0, 2.0, math.nan), 2)):
        m = gnss_velocity.measure(fix(v_l), 0, FRAME, 0.2, 5.0)
        assert m is not None
        assert_allclose(m.z, v_l[:rows])
        assert_allclose(m.R, np.eye(rows) * 0.04)
    for missing in (None, (math.nan, 1.0, 2.0), (1.0, math.nan, 2.0)):
        assert gnss_velocity.measure(fix(missing), 0, FRAME, 0.2, 5.0) is None


def test_velocity_is_turned_to_the_level_of_the_fix() -> None:
    m = gnss_velocity.measure(fix((10.0, -4.0, 1.0)), 0, FRAME, 0.2, 5.0)
    assert m is not None
    x = state()
    x[3:6] = FRAME.local_level(0.83, 0.2).T @ [10.0, -4.0, 1.0]
    r, H = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-12)
    assert_allclose(H[:, 3:6], FRAME.local_level(0.83, 0.2), atol=1e-12)


def test_velocity_of_an_antenna_that_swings() -> None:
    m = gnss_velocity.measure(fix((0.0, 0.0, 0.0)), 0, FRAME, 0.2, 5.0)
    assert m is not None
    x = state()
    x[16:19] = [2.0, 0.0, 0.0]
    u = np.array([0.0, 0.0, 0.5, 0.0, 0.0, -9.8])
    r, _ = m.model(x, u, m.z, m.parameters)
    assert_allclose(r, -(FRAME.local_level(0.83, 0.2) @ [0.0, 1.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("yaw", "z", "expected"), [(3.1, -3.1, 2 * math.pi - 6.2), (-3.1, 3.1, 6.2 - 2 * math.pi)]
)
def test_heading_wraps_and_is_of_the_local_level_frame(
    yaw: float, z: float, expected: float
) -> None:
    x = state()
    x[:3] = FRAME.from_lla(0.83, 0.2, 900.0)
    C_nl = FRAME.local_level(0.83, 0.2).T
    x[6:10] = quat_mul(dcm_to_quat(C_nl), euler_to_quat(0.1, -0.2, yaw))
    m = heading.measure(HeadingFix(0, z), 0, FRAME, 0.05, 5.0)
    r, _ = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, [expected], atol=1e-12)
    assert_allclose(m.R, [[0.0025]])


def test_zero_velocity_is_in_n() -> None:
    m = zero_velocity.measure(2_000_000, 1_750_000, 0.1, 5.0)
    x = state()
    x[3:6] = [0.1, -0.2, 0.3]
    r, H = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, [-0.1, 0.2, -0.3])
    assert_allclose(H[:, 3:6], np.eye(3))
    assert np.count_nonzero(H) == 3


def test_a_field_is_read_along_the_body_s_axes() -> None:
    m = magnetometer.measure(
        "mag", 7, 5, np.array([0.1, -0.4, 0.9]), np.array([0.4, 0.1, 0.9]), 0.02, 5.0
    )
    assert (m.stamp_us, m.t_us, m.source, m.gate) == (7, 5, "mag", 5.0)
    assert_allclose(m.R, np.eye(3) * 4e-4)
    # heading east, north is to the left
    r, _ = m.model(state(math.pi / 2), U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-12)


def test_zero_rate_leaves_the_bias_of_a_gyro_that_sees_the_earth_turn() -> None:
    x = state(0.7)
    x[10:13] = [0.01, -0.02, 0.03]
    reading = x[10:13] + quat_to_dcm(x[6:10]).T @ FRAME.w_ie_n
    m = zero_rate.measure(2_000_000, 1_750_000, reading, FRAME, 0.02, 5.0)
    assert (m.stamp_us, m.t_us) == (2_000_000, 1_750_000)
    assert_allclose(m.R, np.eye(3) * 4e-4)
    r, H = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-15)
    assert_allclose(H[:, 9:12], np.eye(3))
    # the reading of this instant has no part in it
    assert_allclose(m.model(x, 2.0 * U, m.z, m.parameters)[0], r)


def test_magnetic_field_is_the_reference_turned_into_b() -> None:
    m_n = np.array([0.3, 0.1, 0.9])
    x = state()
    x[6:10] = euler_to_quat(0.2, -0.1, 2.0)
    m = magnetometer.measure("compass", 7, 5, quat_to_dcm(x[6:10]).T @ m_n, m_n, 0.05, 4.0)
    assert (m.stamp_us, m.t_us, m.source, m.gate) == (7, 5, "compass", 4.0)
    assert_allclose(m.R, np.eye(3) * 0.0025)
    r, H = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-15)
    # turning about the field itself changes nothing
    assert_allclose(H[:, 6:9] @ m.z, 0.0, atol=1e-15)


def test_baro_is_the_altitude_far_from_the_origin_too() -> None:
    m = baro.measure(7, 5, 903.0, FRAME, 2.0, 5.0, "baro")
    x = state()
    x[:3] = FRAME.from_lla(0.83, 0.2, 900.0)
    r, H = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, [3.0], atol=1e-7)
    assert_allclose(H[0, :3], -FRAME.local_level(0.83, 0.2)[2], atol=1e-12)
    assert_allclose(m.R, [[4.0]])


def test_gravity_tilt_of_a_vehicle_at_rest() -> None:
    x = state()
    x[6:10] = euler_to_quat(0.2, -0.1, 2.0)
    x[13:16] = [0.1, 0.2, -0.1]
    g_n = gravity_n(x[:3], FRAME.r0_e, FRAME.C_ne)
    at_rest = quat_to_dcm(x[6:10]).T @ -g_n + x[13:16]
    m = gravity_tilt.measure(7, 5, at_rest, FRAME, 0.5, 5.0)
    r, _ = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-12)


def test_wheels_swing_the_imu_that_is_not_on_the_axle() -> None:
    m = nonholonomic.measure(7, 5, np.array([-2.0, 0.0, 0.5]), 0.1, 5.0)
    x = state(0.7)
    u = np.array([0.0, 0.0, 0.5, 0.0, 0.0, -9.8])
    # driving at 8 m/s the IMU, 2 m before the axle, moves to the right with 2 m x 0.5 rad/s
    x[3:6] = quat_to_dcm(x[6:10]) @ [8.0, 1.0, 0.0]
    r, _ = m.model(x, u, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-12)


def test_the_direction_of_a_field_tells_of_hard_iron_without_its_strength() -> None:
    m_n = np.array([0.48, 0.0, math.sqrt(1.0 - 0.48**2)])
    x = state()
    x[6:10] = euler_to_quat(0.2, -0.1, 2.0)
    x[21:24] = [0.3, -0.2, 0.1]
    w = quat_to_dcm(x[6:10]).T @ m_n + x[21:24]
    z = w / np.linalg.norm(w)
    m = magnetometer.measure("mag", 7, 5, z, m_n, 0.05, 4.0, directions=True)
    r, _ = m.model(x, U, m.z, m.parameters)
    assert_allclose(r, 0.0, atol=1e-15)
    rng = np.random.default_rng(2)
    m = m._replace(z=z + 0.01 * rng.normal(size=3))
    _, H = m.model(x, U, m.z, m.parameters)
    columns, h = Layout.of(BLOCKS).columns, 1e-6
    for i in range(H.shape[1]):
        ends = []
        for sign in (1.0, -1.0):
            y, d = x.copy(), np.zeros(H.shape[1])
            d[i] = sign * h
            boxplus(y, d, columns)
            ends.append(m.model(y, U, m.z, m.parameters)[0])
        assert_allclose(H[:, i], (ends[1] - ends[0]) / (2 * h), atol=1e-8)
