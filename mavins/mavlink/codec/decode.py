"""Payload bytes -> SI: the decoders of the streamed sensor messages, and of a simulator's truth
apart from them.

`decode` never raises on wire garbage: it returns `Invalid` with a reason for a message it handles
but cannot use, and None for one it does not handle. Units on the wire are those of MAVLink's
common.xml.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Final, TypeAlias

import numpy as np

from mavins.mavlink.codec.fields import Fields, fields_of
from mavins.mavlink.codec.framing import Frames
from mavins.mavlink.codec.messages import (
    Attitude,
    GlobalPosition,
    GpsInput,
    GpsRaw,
    Heartbeat,
    HilGps,
    HilState,
    ImuMessage,
    Invalid,
    Message,
    OriginRequest,
    SimState,
    SystemTime,
    Truth,
)

Values: TypeAlias = tuple[Any, ...]

STANDARD_GRAVITY: Final = 9.80665
MAX_ACCEL: Final = 2000.0
"""m/s^2; no sensor of a vehicle reads more, so more is damage."""
MAX_GYRO: Final = 100.0
"""rad/s, likewise."""
MAX_SPEED: Final = 1000.0
"""m/s, likewise."""
MAX_ALTITUDE: Final = 100_000.0
"""m, likewise."""
FIRST_UNIX_US: Final = 10**15
"""A stamp above this (2001) counts from 1970, below it from boot."""

STAMP_LIMIT: Final = 2**62
"""Microseconds; a greater stamp is damage (and would not fit into int64 arithmetic)."""

_U16: Final = 0xFFFF
_U32: Final = 0xFFFFFFFF
_DEG_E7: Final = math.radians(1e-7)
_CDEG: Final = math.radians(1e-2)
ACCEL_AND_GYRO: Final = 0x3F
SCALED_KINDS: Final = ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
SI: Final = (1.0, 1.0)
MILLI: Final = (STANDARD_GRAVITY * 1e-3, 1e-3)
"""Wire units of accelerometer and gyro: m/s^2 and rad/s, or mg and mrad/s."""

_IGNORE_ALT: Final = 1
_IGNORE_HDOP: Final = 2
_IGNORE_VDOP: Final = 4
_IGNORE_VEL_HORIZ: Final = 8
_IGNORE_VEL_VERT: Final = 16
_IGNORE_SPEED_ACC: Final = 32
_IGNORE_HORIZ_ACC: Final = 64
_IGNORE_VERT_ACC: Final = 128


class _UnusableError(Exception):
    """Raised inside a decoder, never out of this file; the text is the reason."""


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
    except _UnusableError as unusable:
        return Invalid(fields.name, str(unusable))


def _check(in_range: bool, reason: str) -> None:
    if not in_range:
        raise _UnusableError(reason)


def _finite(*values: float) -> None:
    _check(all(map(math.isfinite, values)), "not a finite number")


def _position(lat_e7: int, lon_e7: int, alt: float, fix_type: int = 3) -> tuple[float, float]:
    """(lat, lon) in rad; latitude 0 / longitude 0 with a fix is how receivers say 'nowhere'."""
    _check(abs(lat_e7) <= 900_000_000 and abs(lon_e7) <= 1_800_000_000, "position out of range")
    _check(abs(alt) <= MAX_ALTITUDE, "altitude out of range")
    _check(fix_type < 2 or lat_e7 != 0 or lon_e7 != 0, "position 0/0")
    return lat_e7 * _DEG_E7, lon_e7 * _DEG_E7


def _speed_in_range(*components: float) -> None:
    _finite(*components)
    _check(all(abs(v) <= MAX_SPEED for v in components), "velocity out of range")


def _known(raw: int, unknown: int, scale: float) -> float | None:
    """An accuracy in SI; zero and the type's maximum mean that the receiver does not know it."""
    return None if raw in (0, unknown) else raw * scale


def _yaw(cdeg: int) -> float | None:
    """A heading in [0, 2 pi): 0 means none, 36000 north, anything above not available."""
    return None if cdeg == 0 or cdeg > 36000 else cdeg % 36000 * _CDEG


def _course(cdeg: int) -> float | None:
    return None if cdeg > 36000 else cdeg % 36000 * _CDEG


def _imu(
    kind: str, imu_id: int, stamp_us: int, v: Values, units: tuple[float, float]
) -> ImuMessage:
    _check(stamp_us < STAMP_LIMIT, "stamp out of range")
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
    _check(in_range, "reading out of range")
    return ImuMessage(kind, imu_id, stamp_us, np.array((ax, ay, az)), np.array((gx, gy, gz)))


def _highres_imu(v: Values) -> ImuMessage:
    _check(v[14] & ACCEL_AND_GYRO == ACCEL_AND_GYRO, "no new accelerometer and gyro")
    return _imu("HIGHRES_IMU", v[15], v[0], v, SI)


def _raw_imu(v: Values) -> ImuMessage:
    return _imu("RAW_IMU", v[10], v[0], v, MILLI)


def _scaled_imu(v: Values, imu_id: int) -> ImuMessage:
    return _imu(SCALED_KINDS[imu_id], imu_id, v[0] * 1000, v, MILLI)


def _gps_raw_int(v: Values) -> GpsRaw:
    stamp, lat, lon, alt, eph, epv, vel, cog, fix, sats, _, h_acc, v_acc, vel_acc, hdg_acc, yaw = v
    _check(stamp < STAMP_LIMIT, "stamp out of range")
    lat_rad, lon_rad = _position(lat, lon, alt * 1e-3, fix)
    return GpsRaw(
        stamp_us=stamp,
        fix_type=fix,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        speed=None if vel == _U16 else vel * 1e-2,
        course=_course(cog),
        satellites=None if sats == 255 else sats,
        eph=_known(eph, _U16, 1e-2),
        epv=_known(epv, _U16, 1e-2),
        h_acc=_known(h_acc, _U32, 1e-3),
        v_acc=_known(v_acc, _U32, 1e-3),
        vel_acc=_known(vel_acc, _U32, 1e-3),
        hdg_acc=_known(hdg_acc, _U32, math.radians(1e-5)),
        yaw=_yaw(yaw),
    )


def _global_position_int(v: Values) -> GlobalPosition:
    stamp_ms, lat, lon, alt, relative_alt, vx, vy, vz, hdg = v
    lat_rad, lon_rad = _position(lat, lon, alt * 1e-3)
    return GlobalPosition(
        stamp_us=stamp_ms * 1000,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        relative_alt=relative_alt * 1e-3,
        v_l=(vx * 1e-2, vy * 1e-2, vz * 1e-2),
        heading=_course(hdg),
    )


def _gps_input(v: Values) -> GpsInput:
    (stamp, _, lat, lon, alt, hdop, vdop, vn, ve, vd, vel_acc, h_acc, v_acc) = v[:13]
    ignore, _, gps_id, fix, sats, yaw = v[13:]

    def used(value: float, flag: int) -> float | None:
        if ignore & flag:
            return None
        _finite(value)
        return value

    def accuracy(value: float, flag: int) -> float | None:
        return value if not ignore & flag and 0.0 < value < _U16 else None

    _check(stamp < STAMP_LIMIT, "stamp out of range")
    altitude = used(alt, _IGNORE_ALT)
    lat_rad, lon_rad = _position(lat, lon, altitude or 0.0, fix)
    v_n, v_e = (math.nan, math.nan) if ignore & _IGNORE_VEL_HORIZ else (vn, ve)
    v_d = math.nan if ignore & _IGNORE_VEL_VERT else vd
    _speed_in_range(*([] if ignore & _IGNORE_VEL_HORIZ else [v_n, v_e]))
    _speed_in_range(*([] if ignore & _IGNORE_VEL_VERT else [v_d]))
    no_velocity = ignore & _IGNORE_VEL_HORIZ and ignore & _IGNORE_VEL_VERT
    return GpsInput(
        stamp_us=stamp,
        gps_id=gps_id,
        fix_type=fix,
        lat=lat_rad,
        lon=lon_rad,
        alt=altitude,
        v_l=None if no_velocity else (v_n, v_e, v_d),
        satellites=None if sats == 255 else sats,
        hdop=accuracy(hdop, _IGNORE_HDOP),
        vdop=accuracy(vdop, _IGNORE_VDOP),
        h_acc=accuracy(h_acc, _IGNORE_HORIZ_ACC),
        v_acc=accuracy(v_acc, _IGNORE_VERT_ACC),
        vel_acc=accuracy(vel_acc, _IGNORE_SPEED_ACC),
        yaw=_yaw(yaw),
    )


def _hil_gps(v: Values) -> HilGps:
    stamp, lat, lon, alt, eph, epv, _, vn, ve, vd, _, fix, sats, gps_id, yaw = v
    _check(stamp < STAMP_LIMIT, "stamp out of range")
    lat_rad, lon_rad = _position(lat, lon, alt * 1e-3, fix)
    return HilGps(
        stamp_us=stamp,
        gps_id=gps_id,
        fix_type=fix,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        v_l=(vn * 1e-2, ve * 1e-2, vd * 1e-2),
        satellites=None if sats == 255 else sats,
        eph=_known(eph, _U16, 1e-2),
        epv=_known(epv, _U16, 1e-2),
        yaw=_yaw(yaw),
    )


def _attitude(v: Values) -> Attitude:
    stamp_ms, roll, pitch, yaw, *rates = v
    _finite(roll, pitch, yaw, *rates)
    _check(max(abs(roll), abs(pitch), abs(yaw)) <= 7.0, "angle out of range")  # a turn, either sign
    return Attitude(stamp_ms * 1000, roll, pitch, yaw, (rates[0], rates[1], rates[2]))


def _system_time(v: Values) -> SystemTime:
    return SystemTime(v[0] if FIRST_UNIX_US < v[0] < STAMP_LIMIT else None, v[1] * 1000)


def _heartbeat(v: Values) -> Heartbeat:
    custom_mode, mav_type, autopilot, base_mode, system_status, _ = v
    return Heartbeat(mav_type, autopilot, base_mode, system_status, custom_mode)


def _set_gps_global_origin(v: Values) -> OriginRequest:
    lat, lon, alt, target_system, _ = v
    lat_rad, lon_rad = _position(lat, lon, alt * 1e-3)
    return OriginRequest(target_system, lat_rad, lon_rad, alt * 1e-3)


def _unit(q: tuple[float, ...]) -> tuple[float, float, float, float]:
    _finite(*q)
    norm = math.hypot(*q)
    _check(abs(norm - 1.0) < 0.1, "not a unit quaternion")
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def _hil_state_quaternion(v: Values) -> HilState:
    stamp, *q_and_rates = v[:8]
    _check(stamp < STAMP_LIMIT, "stamp out of range")
    lat, lon, alt, vx, vy, vz = v[8:14]
    lat_rad, lon_rad = _position(lat, lon, alt * 1e-3)
    rates = q_and_rates[4:]
    _finite(*rates)
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
    _finite(alt)
    _speed_in_range(*v_l)
    lat_rad, lon_rad = _position(lat, lon, alt)
    return SimState(lat_rad, lon_rad, alt, (v_l[0], v_l[1], v_l[2]), _unit(v[:4]))


def _table(**decoders: Callable[[Values], Any]) -> dict[int, tuple[Fields, Callable[..., Any]]]:
    return {fields_of(name).msgid: (fields_of(name), f) for name, f in decoders.items()}


_DECODERS: Final = _table(
    HIGHRES_IMU=_highres_imu,
    SCALED_IMU=functools.partial(_scaled_imu, imu_id=0),
    SCALED_IMU2=functools.partial(_scaled_imu, imu_id=1),
    SCALED_IMU3=functools.partial(_scaled_imu, imu_id=2),
    RAW_IMU=_raw_imu,
    GPS_RAW_INT=_gps_raw_int,
    GLOBAL_POSITION_INT=_global_position_int,
    GPS_INPUT=_gps_input,
    HIL_GPS=_hil_gps,
    ATTITUDE=_attitude,
    SYSTEM_TIME=_system_time,
    HEARTBEAT=_heartbeat,
    SET_GPS_GLOBAL_ORIGIN=_set_gps_global_origin,
)
_TRUTH_DECODERS: Final = _table(HIL_STATE_QUATERNION=_hil_state_quaternion, SIM_STATE=_sim_state)
