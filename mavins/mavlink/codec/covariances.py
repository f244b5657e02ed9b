"""NavSolution -> the messages that carry a covariance: a position in n, one in l, an attitude in l.

Only what the filter estimates has a variance here: the white noise of the IMU is in none of them. Theory:
docs/theory/outputs.md.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec.encode import Payload, deg_e7, payload
from mavins.mavlink.codec.fields import fields_of
from mavins.nav.earth import EARTH_RATE, normal_gravity
from mavins.nav.so3 import euler_jacobian, quat_to_dcm, skew
from mavins.types import FloatArray, NavSolution

_P, _V, _THETA, _B_A = slice(0, 3), slice(3, 6), slice(6, 9), slice(12, 15)
_UPPER_9: Final = np.triu_indices(9)
_UP: Final = np.array([1.0, 1.0, -1.0])
"""Latitude and longitude grow with north and east, altitude against down."""

_LOCAL_POSITION_NED_COV: Final = fields_of("LOCAL_POSITION_NED_COV")
_ATTITUDE_QUATERNION_COV: Final = fields_of("ATTITUDE_QUATERNION_COV")
_GLOBAL_POSITION_INT_COV: Final = fields_of("GLOBAL_POSITION_INT_COV")


def dcm_nl(solution: NavSolution) -> FloatArray:
    """C_nl (3, 3): takes the local level frame at the vehicle to n."""
    return np.asarray(quat_to_dcm(solution.q_nb) @ quat_to_dcm(solution.q_lb).T)


def earth_rate_n(solution: NavSolution) -> FloatArray:
    """w_ie (3,) in n, rad/s."""
    axis_l = np.array([math.cos(solution.lat), 0.0, -math.sin(solution.lat)])
    return np.asarray(EARTH_RATE * (dcm_nl(solution) @ axis_l))


def acceleration_n(solution: NavSolution) -> FloatArray:
    """v_n' (3,) in m/s^2: C_nb f_b + g_n(p) - 2 w_ie x v_n, of bias-corrected readings."""
    g_l = np.array([0.0, 0.0, normal_gravity(math.sin(solution.lat), solution.alt)])
    coriolis = 2.0 * np.cross(earth_rate_n(solution), solution.v_n)
    return np.asarray(quat_to_dcm(solution.q_nb) @ solution.f_b + dcm_nl(solution) @ g_l - coriolis)


def motion_covariance(solution: NavSolution) -> FloatArray:
    """(9, 9) covariance of p_n, v_n and v_n': J P J^T.

    With the local error C = C^ [I + [theta]x]: d v' = -2 [w_ie]x d v - C [f_b]x theta - C d b_a; the gravity
    gradient (3e-6 1/s^2) is left out.
    """
    c_nb = quat_to_dcm(solution.q_nb)
    jacobian = np.zeros((9, solution.P.shape[0]))
    jacobian[0:3, _P] = np.eye(3)
    jacobian[3:6, _V] = np.eye(3)
    jacobian[6:9, _V] = -2.0 * skew(earth_rate_n(solution))
    jacobian[6:9, _THETA] = -c_nb @ skew(solution.f_b)
    jacobian[6:9, _B_A] = -c_nb
    return np.asarray(jacobian @ solution.P @ jacobian.T)


def local_position_ned_cov(
    solution: NavSolution, estimator_type: int = dialect.MAV_ESTIMATOR_TYPE_GPS_INS
) -> Payload:
    """LOCAL_POSITION_NED_COV: p_n, v_n, v_n' and the upper triangle of their covariance, row by row."""
    x, y, z = solution.p_n.tolist()
    vx, vy, vz = solution.v_n.tolist()
    ax, ay, az = acceleration_n(solution).tolist()
    return payload(
        _LOCAL_POSITION_NED_COV,
        time_usec=solution.t_us,
        x=x,
        y=y,
        z=z,
        vx=vx,
        vy=vy,
        vz=vz,
        ax=ax,
        ay=ay,
        az=az,
        covariance=motion_covariance(solution)[_UPPER_9].tolist(),
        estimator_type=estimator_type,
    )


def euler_covariance(solution: NavSolution) -> FloatArray:
    """(3, 3) covariance of roll, pitch, yaw in l, rad^2: E P_theta E^T."""
    jacobian = euler_jacobian(solution.roll, solution.pitch)
    return np.asarray(jacobian @ solution.P[_THETA, _THETA] @ jacobian.T)


def attitude_quaternion_cov(solution: NavSolution) -> Payload:
    """ATTITUDE_QUATERNION_COV: q_lb, bias-corrected rates, all nine of the covariance of roll, pitch, yaw."""
    rollspeed, pitchspeed, yawspeed = solution.w_b.tolist()
    return payload(
        _ATTITUDE_QUATERNION_COV,
        time_usec=solution.t_us,
        q=solution.q_lb.tolist(),
        rollspeed=rollspeed,
        pitchspeed=pitchspeed,
        yawspeed=yawspeed,
        covariance=euler_covariance(solution).ravel().tolist(),
    )


def global_covariance(solution: NavSolution) -> FloatArray:
    """(6, 6) covariance of the position in m towards north, east and up and of v_l in m/s.

    MAVLink gives no unit for latitude and longitude here; metres are what a float can hold and a reader can use.
    """
    c_ln = dcm_nl(solution).T
    jacobian = np.zeros((6, solution.P.shape[0]))
    jacobian[0:3, _P] = _UP[:, np.newaxis] * c_ln
    jacobian[3:6, _V] = c_ln
    return np.asarray(jacobian @ solution.P @ jacobian.T)


def global_position_int_cov(
    solution: NavSolution,
    home_alt: float,
    estimator_type: int = dialect.MAV_ESTIMATOR_TYPE_GPS_INS,
) -> Payload:
    """GLOBAL_POSITION_INT_COV: position, v_l (NED) and all 36 of their covariance; relative_alt counts from
    `home_alt`, m above mean sea level.
    """
    vx, vy, vz = solution.v_l.tolist()
    return payload(
        _GLOBAL_POSITION_INT_COV,
        time_usec=solution.t_us,
        lat=deg_e7(solution.lat),
        lon=deg_e7(solution.lon),
        alt=solution.alt * 1e3,
        relative_alt=(solution.alt - home_alt) * 1e3,
        vx=vx,
        vy=vy,
        vz=vz,
        covariance=global_covariance(solution).ravel().tolist(),
        estimator_type=estimator_type,
    )
