"""NavSolution -> what PX4 and ArduPilot take from outside as a measurement.

Each of them wants another label on the same pose. Stamps are given apart: an autopilot reads them on the clock that
our TIMESYNC answers tell it of. Which parameters turn these on, and why seldom: docs/autopilots.md.
"""

from __future__ import annotations

import math
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec.encode import Payload, deg_e7, heading_cdeg, payload
from mavins.mavlink.codec.fields import fields_of
from mavins.mavlink.codec.outputs import odometry, pose_upper_triangle
from mavins.nav.so3 import quat_to_euler
from mavins.types import Health, NavSolution

LEAP_SECONDS: Final = 18
"""GPS time minus UTC, since 2017; ArduPilot uses GPS_INPUT's time for differences only."""
GPS_EPOCH_UNIX_S: Final = 315_964_800
"""1980-01-06 in UNIX seconds."""
_WEEK_MS: Final = 7 * 86_400_000
_RANGE_ERROR: Final = 1.0
"""m, 1-sigma of one satellite's range, by which an accuracy is turned into a dilution of precision."""
_MAX_DOP: Final = 99.99

_VISION_POSITION_ESTIMATE: Final = fields_of("VISION_POSITION_ESTIMATE")
_GPS_INPUT: Final = fields_of("GPS_INPUT")


def odometry_for_px4(solution: NavSolution, stamp_us: int, quality: int) -> Payload:
    """ODOMETRY as PX4 takes it: pose in MAV_FRAME_LOCAL_NED, twist in b, estimator type VIO.

    PX4 refuses GPS_INS, which is what we are, with a critical text for each message.
    """
    return odometry(solution, dialect.MAV_ESTIMATOR_TYPE_VIO, quality, stamp_us=stamp_us)


def odometry_for_ardupilot(solution: NavSolution, stamp_us: int, quality: int) -> Payload:
    """ODOMETRY as ArduPilot takes it: pose in MAV_FRAME_LOCAL_FRD, twist in b, estimator type VIO.

    LOCAL_FRD is a level frame, fixed to the Earth, with a forward axis of the sender's choice, and ArduPilot (VISO_TYPE
    1) puts that axis north. Ours is north: the frame is n under another name, and neither pose nor covariance turns.
    """
    return odometry(
        solution,
        dialect.MAV_ESTIMATOR_TYPE_VIO,
        quality,
        frame_id=dialect.MAV_FRAME_LOCAL_FRD,
        stamp_us=stamp_us,
    )


def vision_position_estimate(solution: NavSolution, stamp_us: int) -> Payload:
    """VISION_POSITION_ESTIMATE: p_n, roll, pitch, yaw of q_nb, the upper triangle of their covariance."""
    x, y, z = solution.p_n.tolist()
    roll, pitch, yaw = quat_to_euler(solution.q_nb).tolist()
    return payload(
        _VISION_POSITION_ESTIMATE,
        usec=stamp_us,
        x=x,
        y=y,
        z=z,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        covariance=pose_upper_triangle(solution),
        reset_counter=solution.reset_counter % 256,
    )


def gps_time(unix_us: int) -> tuple[int, int]:
    """(week, milliseconds of the week) of GPS time, from microseconds since 1970."""
    ms = unix_us // 1000 + (LEAP_SECONDS - GPS_EPOCH_UNIX_S) * 1000
    return ms // _WEEK_MS, ms % _WEEK_MS


def gps_input(
    solution: NavSolution, stamp_us: int, unix_us: int, gps_id: int, satellites: int
) -> Payload:
    """GPS_INPUT: the solution as receiver number `gps_id` would give it, with everything in it and nothing ignored.

    In dead reckoning it says 'no fix': the autopilot has the IMU that we would then be counting on itself. A receiver
    without dilutions of precision is not accepted, so they are the accuracies over a range error of 1 m.
    """
    variance = solution.P.diagonal()
    sigma_h = math.sqrt(max(variance[0:2]))
    sigma_v = math.sqrt(variance[2])
    week, week_ms = gps_time(unix_us)
    vn, ve, vd = solution.v_l.tolist()
    running = solution.health == Health.RUNNING
    return payload(
        _GPS_INPUT,
        time_usec=stamp_us,
        time_week_ms=week_ms,
        time_week=week,
        lat=deg_e7(solution.lat),
        lon=deg_e7(solution.lon),
        alt=solution.alt,
        hdop=min(sigma_h / _RANGE_ERROR, _MAX_DOP),
        vdop=min(sigma_v / _RANGE_ERROR, _MAX_DOP),
        vn=vn,
        ve=ve,
        vd=vd,
        speed_accuracy=math.sqrt(max(variance[3:6])),
        horiz_accuracy=sigma_h,
        vert_accuracy=sigma_v,
        ignore_flags=0,
        gps_id=gps_id,
        fix_type=dialect.GPS_FIX_TYPE_3D_FIX if running else dialect.GPS_FIX_TYPE_NO_FIX,
        satellites_visible=satellites,
        yaw=heading_cdeg(solution.yaw) or 36000,
    )
