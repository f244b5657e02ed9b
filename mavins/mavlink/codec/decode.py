"""Payload bytes -> SI: the decoders of the streamed sensor messages, and of a simulator's truth
apart from them. Those of GNSS receivers lie in `receivers`.

`decode` never raises on wire garbage: it returns `Invalid` with a reason for a message it handles
but cannot use, and None for one it does not handle. Units on the wire are those of MAVLink's
common.xml.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from mavins.mavlink.codec.checks import (
    MAX_ACCEL,
    MAX_ANGLE,
    MAX_GYRO,
    STAMP_LIMIT,
    UnusableError,
    check,
    course,
    finite,
    position,
    speed_in_range,
)
from mavins.mavlink.codec.fields import Fields, fields_of
from mavins.mavlink.codec.framing import Frames
from mavins.mavlink.codec.messages import (
    Attitude,
    GlobalPosition,
    Heartbeat,
    HilState,
    ImuMessage,
    Invalid,
    LocalPosition,
    Message,
    OriginRequest,
    SimState,
    SystemTime,
    Truth,
)
from mavins.mavlink.codec.receivers import Values, gps2_raw, gps_input, gps_raw_int, hil_gps

STANDARD_GRAVITY: Final = 9.80665
FIRST_UNIX_US: Final = 10**15
"""A stamp above this (2001) counts from 1970, below it from boot."""
ACCEL_AND_GYRO: Final = 0x3F
SCALED_KINDS: Final = ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
SI: Final = (1.0, 1.0)
MILLI: Final = (STANDARD_GRAVITY * 1e-3, 1e-3)
"""Wire units of accelerometer and gyro: m/s^2 and rad/s, or mg and mrad/s."""


def decode(frames: Frames, i: int) -> Message | Invalid | None:
    """The sensor message in packet i; Invalid if it is unusable, None if it is not ours."""
    message: Message | Invalid | None = _run(_DECODERS, frames, i)
    return message


def decode_truth(frames: Frames, i: int) -> Truth | Invalid | None:
    """The simulator's truth in packet i, for evaluation only: no estimator may ask for it."""
    truth: Truth | Invalid | None = _run(_TRUTH_DECODERS, frames, i)
    return truth


def _run(decoders: dict[int, tuple[Fields, Callable[..., Any]]], frames: Frames, i: int) -> Any:
    entry = decoders.get(int(frames.msgid[i]))
    if entry is None:
        return None
    fields, decoder = entry
    values = fields.unpacker.unpack(frames.body(i, fields.unpacker.size))
    try:
        return decoder(values)
    except UnusableError as unusable:
        return Invalid(fields.name, str(unusable))


def _imu(
    kind: str, imu_id: int, stamp_us: int, v: Values, units: tuple[float, float]
) -> ImuMessage:
    check(stamp_us < STAMP_LIMIT, "stamp out of range")
    to_accel, to_gyro = units
    ax, ay, az = v[1] * to_accel, v[2] * to_accel, v[3] * to_accel
    gx, gy, gz = v[4] * to_gyro, v[5] * to_gyro, v[6] * to_gyro
    # of finite readings the sum is finite; min and max alone do not see every NaN
    in_range = (
        math.isfinite(ax + ay + az + gx + gy + gz)
        and max(ax, ay, az) <= MAX_ACCEL
        and min(ax, ay, az) >= -MAX_ACCEL
        and max(gx, gy, gz) <= MAX_GYRO
        and min(gx, gy, gz) >= -MAX_GYRO
    )
    check(in_range, "reading out of range")
    return ImuMessage(kind, imu_id, stamp_us, np.array((ax, ay, az)), np.array((gx, gy, gz)))


def _highres_imu(v: Values) -> ImuMessage:
    check(v[14] & ACCEL_AND_GYRO == ACCEL_AND_GYRO, "no new accelerometer and gyro")
    return _imu("HIGHRES_IMU", v[15], v[0], v, SI)


def _raw_imu(v: Values) -> ImuMessage:
    return _imu("RAW_IMU", v[10], v[0], v, MILLI)


def _scaled_imu(v: Values, imu_id: int) -> ImuMessage:
    return _imu(SCALED_KINDS[imu_id], imu_id, v[0] * 1000, v, MILLI)


def _global_position_int(v: Values) -> GlobalPosition:
    stamp_ms, lat, lon, alt, relative_alt, vx, vy, vz, hdg = v
    lat_rad, lon_rad = position(lat, lon, alt * 1e-3)
    return GlobalPosition(
        stamp_us=stamp_ms * 1000,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        relative_alt=relative_alt * 1e-3,
        v_l=(vx * 1e-2, vy * 1e-2, vz * 1e-2),
        heading=course(hdg),
    )


def _local_position_ned(v: Values) -> LocalPosition:
    stamp_ms, x, y, z, *velocity = v
    finite(x, y, z)
    speed_in_range(*velocity)
    return LocalPosition(stamp_ms * 1000, (x, y, z), (velocity[0], velocity[1], velocity[2]))


def _attitude(v: Values) -> Attitude:
    stamp_ms, roll, pitch, yaw, *rates = v
    finite(roll, pitch, yaw, *rates)
    check(max(abs(roll), abs(pitch), abs(yaw)) <= MAX_ANGLE, "angle out of range")
    return Attitude(stamp_ms * 1000, roll, pitch, yaw, (rates[0], rates[1], rates[2]))


def _system_time(v: Values) -> SystemTime:
    return SystemTime(v[0] if FIRST_UNIX_US < v[0] < STAMP_LIMIT else None, v[1] * 1000)


def _heartbeat(v: Values) -> Heartbeat:
    custom_mode, mav_type, autopilot, base_mode, system_status, _ = v
    return Heartbeat(mav_type, autopilot, base_mode, system_status, custom_mode)


def _set_gps_global_origin(v: Values) -> OriginRequest:
    lat, lon, alt, target_system, _ = v
    lat_rad, lon_rad = position(lat, lon, alt * 1e-3)
    return OriginRequest(target_system, lat_rad, lon_rad, alt * 1e-3)


def _unit(q: tuple[float, ...]) -> tuple[float, float, float, float]:
    finite(*q)
    norm = math.hypot(*q)
    check(abs(norm - 1.0) < 0.1, "not a unit quaternion")
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def _hil_state_quaternion(v: Values) -> HilState:
    stamp, *q_and_rates = v[:8]
    check(stamp < STAMP_LIMIT, "stamp out of range")
    lat, lon, alt, vx, vy, vz = v[8:14]
    lat_rad, lon_rad = position(lat, lon, alt * 1e-3)
    rates = q_and_rates[4:]
    finite(*rates)
    return HilState(
        stamp_us=stamp,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        v_l=(vx * 1e-2, vy * 1e-2, vz * 1e-2),
        q_lb=_unit(tuple(q_and_rates[:4])),
        rates=(rates[0], rates[1], rates[2]),
    )


def _sim_state(v: Values) -> SimState:
    # the float lat and lon have metres of resolution, and in some builds they are not degrees
    lat, lon, alt, v_l = v[21], v[22], v[15], v[18:21]
    finite(alt)
    speed_in_range(*v_l)
    lat_rad, lon_rad = position(lat, lon, alt)
    return SimState(lat_rad, lon_rad, alt, (v_l[0], v_l[1], v_l[2]), _unit(v[:4]))


def _table(**decoders: Callable[[Values], Any]) -> dict[int, tuple[Fields, Callable[..., Any]]]:
    return {fields_of(name).msgid: (fields_of(name), f) for name, f in decoders.items()}


_DECODERS: Final = _table(
    HIGHRES_IMU=_highres_imu,
    SCALED_IMU=functools.partial(_scaled_imu, imu_id=0),
    SCALED_IMU2=functools.partial(_scaled_imu, imu_id=1),
    SCALED_IMU3=functools.partial(_scaled_imu, imu_id=2),
    RAW_IMU=_raw_imu,
    GPS_RAW_INT=gps_raw_int,
    GPS2_RAW=gps2_raw,
    GLOBAL_POSITION_INT=_global_position_int,
    LOCAL_POSITION_NED=_local_position_ned,
    GPS_INPUT=gps_input,
    HIL_GPS=hil_gps,
    ATTITUDE=_attitude,
    SYSTEM_TIME=_system_time,
    HEARTBEAT=_heartbeat,
    SET_GPS_GLOBAL_ORIGIN=_set_gps_global_origin,
)
_TRUTH_DECODERS: Final = _table(HIL_STATE_QUATERNION=_hil_state_quaternion, SIM_STATE=_sim_state)
