"""Covariances as pymavlink reads them, against J P J^T with J by finite differences, far from the origin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavins.mavlink.codec import (
    Payload,
    attitude_quaternion_cov,
    global_position_int_cov,
    local_position_ned_cov,
)
from mavins.mavlink.codec.covariances import acceleration_n
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.so3 import quat_conj, quat_mul, quat_to_dcm, quat_to_euler
from mavins.types import FloatArray, NavSolution, Origin

Far = Callable[..., NavSolution]
Transferred = Callable[[Callable[[NavSolution], FloatArray]], FloatArray]
Decoded = Callable[[Payload], Any]


def close(found: FloatArray, expected: FloatArray, rel: float = 1e-4) -> None:
    """Equal element by element, on the scale of each element's own sigmas."""
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=rel
    )


def test_acceleration_is_that_of_the_mechanization(far: Far, tangent: TangentFrame) -> None:
    s = far()
    expected = (
        quat_to_dcm(s.q_nb) @ s.f_b
        + gravity_n(s.p_n, tangent.r0_e, tangent.C_ne)
        - 2.0 * np.cross(tangent.w_ie_n, s.v_n)
    )
    np.testing.assert_allclose(acceleration_n(s), expected, atol=1e-9)


def test_local_position_ned_cov_is_in_n(
    far: Far, transferred: Transferred, by_pymavlink: Decoded
) -> None:
    s = far()
    message = by_pymavlink(local_position_ned_cov(s))
    assert (message.time_usec, message.estimator_type) == (12_345_678, 5)
    np.testing.assert_allclose([message.x, message.y, message.z], s.p_n, rtol=1e-6)
    np.testing.assert_allclose([message.vx, message.vy, message.vz], s.v_n, rtol=1e-6)
    np.testing.assert_allclose([message.ax, message.ay, message.az], acceleration_n(s), rtol=1e-6)
    expected = transferred(lambda s: np.concatenate([s.p_n, s.v_n, acceleration_n(s)]))
    found = np.zeros((9, 9))
    k = 0
    for i in range(9):  # row after row, each one element shorter
        for j in range(i, 9):
            found[i, j] = found[j, i] = message.covariance[k]
            k += 1
    assert k == len(message.covariance)
    close(found, expected)


def test_attitude_quaternion_cov_is_in_l(
    far: Far, transferred: Transferred, by_pymavlink: Decoded
) -> None:
    s = far()
    message = by_pymavlink(attitude_quaternion_cov(s))
    np.testing.assert_allclose(message.q, s.q_lb, atol=1e-7)
    assert np.abs(s.q_lb - s.q_nb).max() > 0.01, "else n and l could not be told apart"
    np.testing.assert_allclose(
        [message.rollspeed, message.pitchspeed, message.yawspeed], s.w_b, rtol=1e-6
    )
    found = np.reshape(message.covariance, (3, 3))
    close(found, transferred(lambda s: quat_to_euler(s.q_lb)))
    np.testing.assert_allclose(np.sqrt(np.diag(found)), s.sd_euler, rtol=1e-5)


def test_global_position_int_cov_is_north_east_up_and_v_l(
    far: Far, transferred: Transferred, by_pymavlink: Decoded
) -> None:
    s = far()
    message = by_pymavlink(global_position_int_cov(s, home_alt=100.0))
    assert message.lat == pytest.approx(np.degrees(s.lat) * 1e7, abs=1)
    assert message.lon == pytest.approx(np.degrees(s.lon) * 1e7, abs=1)
    assert message.alt == pytest.approx(s.alt * 1e3, abs=1)
    assert message.relative_alt == pytest.approx((s.alt - 100.0) * 1e3, abs=1)
    np.testing.assert_allclose([message.vx, message.vy, message.vz], s.v_l, rtol=1e-6)
    here = TangentFrame.at(Origin(s.lat, s.lon, s.alt))

    def neu_and_velocity(off: NavSolution) -> FloatArray:
        n, e, d = here.from_lla(off.lat, off.lon, off.alt)
        return np.concatenate([[n, e, -d], off.v_l])

    close(np.reshape(message.covariance, (6, 6)), transferred(neu_and_velocity))


def test_covariances_are_symmetric_and_positive(far: Far, by_pymavlink: Decoded) -> None:
    s = far()
    for payload, n in ((attitude_quaternion_cov(s), 3), (global_position_int_cov(s, 0.0), 6)):
        P = np.reshape(by_pymavlink(payload).covariance, (n, n))
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P).min() > 0.0


def test_a_turn_of_n_against_l_is_what_the_solution_says(far: Far) -> None:
    s = far()
    q_ln = quat_mul(s.q_lb, quat_conj(s.q_nb))
    np.testing.assert_allclose(quat_to_dcm(q_ln) @ s.v_n, s.v_l, atol=1e-9)
