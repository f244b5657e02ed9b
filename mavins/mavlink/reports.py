"""What is told of an estimator beside its solution: EKF_STATUS_REPORT, EXTENDED_SYS_STATE, VIBRATION."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as dialect

from mavins.estimator.estimator import Estimator
from mavins.estimator.vibration import Vibration
from mavins.mavlink.codec import Payload, ekf_status_report, extended_sys_state, vibration
from mavins.types import Health

_VELOCITY = dialect.EKF_VELOCITY_HORIZ | dialect.EKF_VELOCITY_VERT
_POSITION = (
    dialect.EKF_POS_HORIZ_REL
    | dialect.EKF_POS_HORIZ_ABS
    | dialect.EKF_POS_VERT_ABS
    | dialect.EKF_PRED_POS_HORIZ_REL
    | dialect.EKF_PRED_POS_HORIZ_ABS
)


def ekf_status_of(estimator: Estimator) -> Payload:
    """EKF_STATUS_REPORT: the newest test ratio of each aiding; without an estimate it says 'uninitialized'."""
    if not estimator.running:
        return ekf_status_report(dialect.EKF_UNINITIALIZED)
    position = _ratio(estimator, "gnss_position")
    velocity = _ratio(estimator, "gnss_velocity")
    flags = dialect.EKF_ATTITUDE
    if estimator.health == Health.RUNNING:
        flags |= _VELOCITY | _POSITION
        if max(position, velocity) >= 1.0:
            flags |= dialect.EKF_GPS_GLITCHING
    return ekf_status_report(
        flags,
        vel_ratio=velocity,
        pos_horiz_ratio=position,
        pos_vert_ratio=position,
        mag_ratio=max(_ratio(estimator, "heading"), _ratio(estimator, "magnetometer")),
    )


def _ratio(estimator: Estimator, aiding: str) -> float:
    """The newest innovation over its gate, 0 where there is none."""
    statistics = estimator.statistics.get(aiding)
    return statistics.last_ratio if statistics is not None and statistics.last_ratio > 0.0 else 0.0


def extended_sys_state_of(estimator: Estimator) -> Payload:
    """EXTENDED_SYS_STATE: on the ground until the first motion, in the air while it moves, else undefined.

    In a steady hover an IMU looks as on the ground, so neither is claimed then.
    """
    if estimator.standing is None:
        return extended_sys_state(dialect.MAV_LANDED_STATE_UNDEFINED)
    return extended_sys_state(
        dialect.MAV_LANDED_STATE_ON_GROUND
        if estimator.standing
        else dialect.MAV_LANDED_STATE_IN_AIR
    )


def vibration_of(estimator: Estimator, shaking: Vibration) -> Payload | None:
    """VIBRATION up to the newest IMU sample, or None before the first."""
    shaking.look(estimator)
    t_us = estimator.t_us
    return None if t_us is None else vibration(t_us, shaking.level, shaking.clipped)
