"""NavSolution -> payloads: what mavins sends of its own estimate, and the small talk around it.

LOCAL_POSITION_NED and ODOMETRY are in n, ATTITUDE, ATTITUDE_QUATERNION and GLOBAL_POSITION_INT in
l.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec.encode import (
    Payload,
    attitude,
    boot_ms,
    deg_e7,
    global_position_int,
    highres_imu,
    payload,
)
from mavins.mavlink.codec.fields import fields_of
from mavins.nav.odometry import write_pose_and_twist
from mavins.types import FloatArray, ImuSample, NavSolution, Origin

TEXT_CHUNK: Final = 50
"""Bytes of text in one STATUSTEXT."""
UNKNOWN_VOLTAGE: Final = 0xFFFF

_UPPER_6: Final = np.triu_indices(6)

_LOCAL_POSITION_NED: Final = fields_of("LOCAL_POSITION_NED")
_ATTITUDE_QUATERNION: Final = fields_of("ATTITUDE_QUATERNION")
_ODOMETRY: Final = fields_of("ODOMETRY")
_ESTIMATOR_STATUS: Final = fields_of("ESTIMATOR_STATUS")
_SYS_STATUS: Final = fields_of("SYS_STATUS")
_GPS_GLOBAL_ORIGIN: Final = fields_of("GPS_GLOBAL_ORIGIN")
_HOME_POSITION: Final = fields_of("HOME_POSITION")
_STATUSTEXT: Final = fields_of("STATUSTEXT")
_COMMAND_ACK: Final = fields_of("COMMAND_ACK")
_MESSAGE_INTERVAL: Final = fields_of("MESSAGE_INTERVAL")
_PARAM_VALUE: Final = fields_of("PARAM_VALUE")
_PARAM_ERROR: Final = fields_of("PARAM_ERROR")
_AUTOPILOT_VERSION: Final = fields_of("AUTOPILOT_VERSION")


def local_position_ned(solution: NavSolution) -> Payload:
    """LOCAL_POSITION_NED: p_n in m and v_n in m/s."""
    x, y, z = solution.p_n.tolist()
    vx, vy, vz = solution.v_n.tolist()
    ms = boot_ms(solution.t_us)
    return payload(_LOCAL_POSITION_NED, time_boot_ms=ms, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)


def attitude_from(solution: NavSolution) -> Payload:
    """ATTITUDE in l, bias-corrected rates."""
    rates = solution.w_b.tolist()
    return attitude(solution.t_us, solution.roll, solution.pitch, solution.yaw, rates)


def attitude_quaternion(solution: NavSolution) -> Payload:
    """ATTITUDE_QUATERNION: q_lb, bias-corrected rates."""
    q1, q2, q3, q4 = solution.q_lb.tolist()
    rollspeed, pitchspeed, yawspeed = solution.w_b.tolist()
    return payload(
        _ATTITUDE_QUATERNION,
        time_boot_ms=boot_ms(solution.t_us),
        q1=q1,
        q2=q2,
        q3=q3,
        q4=q4,
        rollspeed=rollspeed,
        pitchspeed=pitchspeed,
        yawspeed=yawspeed,
    )


def global_position_from(solution: NavSolution, home_alt: float) -> Payload:
    """GLOBAL_POSITION_INT; relative_alt counts from `home_alt`, m above mean sea level."""
    return global_position_int(
        solution.t_us,
        solution.lat,
        solution.lon,
        solution.alt,
        solution.alt - home_alt,
        solution.v_l.tolist(),
        solution.yaw,
    )


def highres_imu_from(solution: NavSolution) -> Payload:
    """HIGHRES_IMU of the bias-corrected specific force and rates."""
    return highres_imu(ImuSample(solution.t_us, solution.f_b, solution.w_b))


def pose_and_twist(solution: NavSolution) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(v_b (3,), pose covariance (6, 6), twist covariance (6, 6)) as ODOMETRY has them."""
    v_b, covariances = np.empty(3), np.empty((2, 6, 6))
    write_pose_and_twist(solution.q_nb, solution.v_n, solution.P, v_b, covariances)
    return v_b, covariances[0], covariances[1]


def odometry(
    solution: NavSolution,
    estimator_type: int = dialect.MAV_ESTIMATOR_TYPE_GPS_INS,
    quality: int = 0,
) -> Payload:
    """ODOMETRY: pose in n (MAV_FRAME_LOCAL_NED), twist in b (MAV_FRAME_BODY_FRD), upper triangles
    of both covariances, row by row. `quality` is -1 failed, 0 unknown, 1..100 percent.
    """
    x, y, z = solution.p_n.tolist()
    v_b, pose, twist = pose_and_twist(solution)
    vx, vy, vz = v_b.tolist()
    rollspeed, pitchspeed, yawspeed = solution.w_b.tolist()
    return payload(
        _ODOMETRY,
        time_usec=solution.t_us,
        frame_id=dialect.MAV_FRAME_LOCAL_NED,
        child_frame_id=dialect.MAV_FRAME_BODY_FRD,
        x=x,
        y=y,
        z=z,
        q=solution.q_nb.tolist(),
        vx=vx,
        vy=vy,
        vz=vz,
        rollspeed=rollspeed,
        pitchspeed=pitchspeed,
        yawspeed=yawspeed,
        pose_covariance=pose[_UPPER_6].tolist(),
        velocity_covariance=twist[_UPPER_6].tolist(),
        reset_counter=solution.reset_counter % 256,
        estimator_type=estimator_type,
        quality=quality,
    )


def estimator_status(
    solution: NavSolution,
    flags: int,
    *,
    vel_ratio: float = 0.0,
    pos_horiz_ratio: float = 0.0,
    pos_vert_ratio: float = 0.0,
    mag_ratio: float = 0.0,
) -> Payload:
    """ESTIMATOR_STATUS: `flags` of ESTIMATOR_STATUS_FLAGS, test ratios (innovation / gate), 1-sigma
    accuracies.
    """
    return payload(
        _ESTIMATOR_STATUS,
        time_usec=solution.t_us,
        flags=flags,
        vel_ratio=vel_ratio,
        pos_horiz_ratio=pos_horiz_ratio,
        pos_vert_ratio=pos_vert_ratio,
        mag_ratio=mag_ratio,
        pos_horiz_accuracy=math.sqrt(max(0.0, solution.P[0, 0] + solution.P[1, 1])),
        pos_vert_accuracy=math.sqrt(max(0.0, solution.P[2, 2])),
    )


def sys_status(
    present: int,
    enabled: int,
    health: int,
    *,
    load: float = 0.0,
    drop_rate: float = 0.0,
    errors: int = 0,
) -> Payload:
    """SYS_STATUS: three sets of MAV_SYS_STATUS_SENSOR bits, processor load and packet loss in 0..1,
    lost packets.

    We have no battery, so its fields are 'unknown'.
    """
    return payload(
        _SYS_STATUS,
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=enabled,
        onboard_control_sensors_health=health,
        load=load * 1e3,
        voltage_battery=UNKNOWN_VOLTAGE,
        current_battery=-1,
        battery_remaining=-1,
        drop_rate_comm=drop_rate * 1e4,
        errors_comm=errors,
    )


def gps_global_origin(origin: Origin, t_us: int) -> Payload:
    """GPS_GLOBAL_ORIGIN: the origin of frame n."""
    return payload(
        _GPS_GLOBAL_ORIGIN,
        latitude=deg_e7(origin.lat),
        longitude=deg_e7(origin.lon),
        altitude=origin.alt * 1e3,
        time_usec=t_us,
    )


def home_position(
    home: Origin, p_n: FloatArray, t_us: int, q: Sequence[float] = (math.nan,) * 4
) -> Payload:
    """HOME_POSITION: home (rad, rad, m above mean sea level), where it lies in n, and `q`, the
    ground's slope and the heading there; NaN where they are not known.
    """
    x, y, z = p_n.tolist()
    return payload(
        _HOME_POSITION,
        latitude=deg_e7(home.lat),
        longitude=deg_e7(home.lon),
        altitude=home.alt * 1e3,
        x=x,
        y=y,
        z=z,
        q=q,
        time_usec=t_us,
    )


def statustext(text: str, severity: int, text_id: int) -> list[Payload]:
    """STATUSTEXT in chunks of 50 bytes, split between characters; `severity` of MAV_SEVERITY.

    A text of one chunk has id 0; of more, the non-zero id that `text_id` gives (taken modulo
    65535).
    """
    chunks, chunk = [], b""
    for character in text:
        encoded = character.encode("utf-8", "replace")
        if len(chunk) + len(encoded) > TEXT_CHUNK:
            chunks.append(chunk)
            chunk = b""
        chunk += encoded
    chunks.append(chunk)
    if len(chunks) > 1 and len(chunks[-1]) == TEXT_CHUNK:
        chunks.append(b"")  # a full chunk says that more follows: readers wait for a short one
    shared_id = 0 if len(chunks) == 1 else 1 + (text_id - 1) % 0xFFFF
    return [
        payload(_STATUSTEXT, severity=severity, text=part, id=shared_id, chunk_seq=k)
        for k, part in enumerate(itertools.islice(chunks, 256))
    ]


def command_ack(
    command: int,
    result: int,
    target_system: int,
    target_component: int,
    *,
    progress: int = 0,
    result_param2: int = 0,
) -> Payload:
    """COMMAND_ACK with a MAV_RESULT for the requester."""
    return payload(
        _COMMAND_ACK,
        command=command,
        result=result,
        progress=progress,
        result_param2=result_param2,
        target_system=target_system,
        target_component=target_component,
    )


def message_interval(message_id: int, interval_us: int) -> Payload:
    """MESSAGE_INTERVAL: -1 where a message is off, 0 where it is not to be had."""
    return payload(_MESSAGE_INTERVAL, message_id=message_id, interval_us=interval_us)


def param_value(name: str, value: float, index: int, count: int) -> Payload:
    """PARAM_VALUE as MAV_PARAM_TYPE_REAL32, which every client reads alike; 65535 is 'no index'."""
    return payload(
        _PARAM_VALUE,
        param_id=name.encode("ascii", "replace"),
        param_value=value,
        param_index=index,
        param_count=count,
        param_type=dialect.MAV_PARAM_TYPE_REAL32,
    )


def param_error(
    name: str, index: int, error: int, target_system: int, target_component: int
) -> Payload:
    """PARAM_ERROR with a MAV_PARAM_ERROR for the requester; an index of -1 means that the name counts."""
    return payload(
        _PARAM_ERROR,
        target_system=target_system,
        target_component=target_component,
        param_id=name.encode("ascii", "replace"),
        param_index=index,
        error=error,
    )


def autopilot_version(capabilities: int, version: tuple[int, int, int], uid: int = 0) -> Payload:
    """AUTOPILOT_VERSION: MAV_PROTOCOL_CAPABILITY bits and our version, marked as an official
    release.
    """
    major, minor, patch = (min(max(part, 0), 255) for part in version)
    return payload(
        _AUTOPILOT_VERSION,
        capabilities=capabilities,
        uid=uid,
        flight_sw_version=major << 24 | minor << 16 | patch << 8 | 255,
    )
