"""What PX4 and ArduPilot are given, as pymavlink reads it: frames, types, layouts, time."""

from __future__ import annotations

import calendar
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import (
    GpsInput,
    Payload,
    decode,
    frame,
    gps_input,
    odometry_for_ardupilot,
    odometry_for_px4,
    scan,
    vision_position_estimate,
)
from mavins.mavlink.codec.to_autopilot import gps_time
from mavins.nav.so3 import quat_to_dcm, quat_to_euler
from mavins.types import FloatArray, Health, NavSolution

Far = Callable[..., NavSolution]
Transferred = Callable[[Callable[[NavSolution], FloatArray]], FloatArray]
Decoded = Callable[[Payload], Any]

UNIX_US = calendar.timegm((2020, 1, 1, 0, 0, 0)) * 1_000_000


def pose(s: NavSolution) -> FloatArray:
    return np.concatenate([s.p_n, quat_to_euler(s.q_nb)])


def twist(s: NavSolution) -> FloatArray:
    return np.concatenate([quat_to_dcm(s.q_nb).T @ s.v_n, s.w_b])


def triangle(elements: list[float]) -> FloatArray:
    """The symmetric 6x6 whose diagonal is at 0, 6, 11, 15, 18, 20."""
    P = np.zeros((6, 6))
    k = 0
    for i in range(6):
        for j in range(i, 6):
            P[i, j] = P[j, i] = elements[k]
            k += 1
    return P


def same(found: FloatArray, expected: FloatArray) -> None:
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-4
    )


@pytest.mark.parametrize(
    ("make", "frame_id"), [(odometry_for_px4, 1), (odometry_for_ardupilot, 20)]
)
def test_odometry(
    make: Any, frame_id: int, far: Far, transferred: Transferred, by_pymavlink: Decoded
) -> None:
    s = far()
    message = by_pymavlink(make(s, 99_000_000, 80))
    assert message.time_usec == 99_000_000
    assert (message.frame_id, message.child_frame_id) == (frame_id, 12)
    assert message.estimator_type == dialect.MAV_ESTIMATOR_TYPE_VIO, "PX4 refuses GPS_INS"
    assert (message.reset_counter, message.quality) == (3, 80)
    np.testing.assert_allclose([message.x, message.y, message.z], s.p_n, rtol=1e-6)
    np.testing.assert_allclose(message.q, s.q_nb, atol=1e-7)
    np.testing.assert_allclose([message.vx, message.vy, message.vz], twist(s)[:3], rtol=1e-6)
    same(triangle(message.pose_covariance), transferred(pose))
    same(triangle(message.velocity_covariance), transferred(twist))


def test_vision_position_estimate(
    far: Far, transferred: Transferred, by_pymavlink: Decoded
) -> None:
    s = far()
    message = by_pymavlink(vision_position_estimate(s, 5_000_000))
    assert (message.usec, message.reset_counter) == (5_000_000, 3)
    found = [message.x, message.y, message.z, message.roll, message.pitch, message.yaw]
    np.testing.assert_allclose(found, pose(s), rtol=1e-6)
    same(triangle(message.covariance), transferred(pose))


def test_gps_input_ignores_nothing(far: Far, by_pymavlink: Decoded) -> None:
    s = far()
    payload = gps_input(s, 5_000_000, UNIX_US, gps_id=1, satellites=14)
    message = by_pymavlink(payload)
    assert (message.ignore_flags, message.gps_id, message.fix_type) == (0, 1, 3)
    assert (message.time_week, message.time_week_ms) == (2086, 259_218_000)
    assert message.satellites_visible == 14
    read = decode(scan(frame(payload, 1, 191, 0), 0), 0)
    assert isinstance(read, GpsInput)
    assert (read.lat, read.lon) == pytest.approx((s.lat, s.lon), abs=1e-9)
    assert read.alt == pytest.approx(s.alt, abs=1e-3)
    assert read.v_l == pytest.approx(tuple(s.v_l), abs=1e-5)
    assert read.h_acc == pytest.approx(math.sqrt(max(s.P[0, 0], s.P[1, 1])), rel=1e-6)
    assert read.v_acc == pytest.approx(math.sqrt(s.P[2, 2]), rel=1e-6)
    assert read.vel_acc == pytest.approx(math.sqrt(max(np.diag(s.P)[3:6])), rel=1e-6)
    assert read.hdop == pytest.approx(read.h_acc, rel=1e-6)
    assert read.yaw == pytest.approx(s.yaw % (2.0 * math.pi), abs=2e-4)


def test_gps_input_towards_north_is_not_the_yaw_that_means_none(
    far: Far, by_pymavlink: Decoded
) -> None:
    north = dataclasses.replace(far(), yaw=1e-6)
    assert by_pymavlink(gps_input(north, 0, UNIX_US, 0, 10)).yaw == 36000
    west = dataclasses.replace(far(), yaw=-math.pi / 2)
    assert by_pymavlink(gps_input(west, 0, UNIX_US, 0, 10)).yaw == 27000


def test_gps_input_of_dead_reckoning_is_no_fix(far: Far, by_pymavlink: Decoded) -> None:
    lost = far(health=Health.DEAD_RECKONING)
    assert by_pymavlink(gps_input(lost, 0, UNIX_US, 0, 10)).fix_type == 1


def test_gps_weeks_turn_on_sunday() -> None:
    sunday = calendar.timegm((2024, 6, 2, 0, 0, 0)) - 18
    assert gps_time(sunday * 1_000_000) == (2317, 0)
    assert gps_time(sunday * 1_000_000 - 1000) == (2316, 604_799_999)
