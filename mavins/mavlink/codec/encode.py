"""SI -> payload bytes: what sensors and simulators send, and the framing of every packet of ours.

Each function returns a `Payload`; `frame` turns it into a MAVLink 2 packet. A value beyond the
wire's range is clamped and a NaN becomes zero, except where MAVLink defines another value as
'unknown'; nothing raises. `t_us` is microseconds since boot; boot milliseconds wrap after 2^32 as
MAVLink has them do.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec.fields import Fields, fields_of
from mavins.types import FloatArray, GnssFix, ImuSample, TruthSample

ACCEL_AND_GYRO: Final = 0x3F
"""HIGHRES_IMU.fields_updated of a sample without magnetometer and barometer."""

_U16: Final = 0xFFFF
_STX: Final = 0xFD
_HEADER: Final = struct.Struct("<BBBBBBBHB")
_STANDARD_GRAVITY: Final = 9.80665

_HIGHRES_IMU: Final = fields_of("HIGHRES_IMU")
_GPS_RAW_INT: Final = fields_of("GPS_RAW_INT")
_GLOBAL_POSITION_INT: Final = fields_of("GLOBAL_POSITION_INT")
_ATTITUDE: Final = fields_of("ATTITUDE")
_SYSTEM_TIME: Final = fields_of("SYSTEM_TIME")
_HEARTBEAT: Final = fields_of("HEARTBEAT")
_HIL_STATE_QUATERNION: Final = fields_of("HIL_STATE_QUATERNION")


@dataclass(frozen=True, slots=True)
class Payload:
    """A message before framing: its id, crc_extra and full-length body in wire units."""

    msgid: int
    crc_extra: int
    body: bytes


def payload(fields: Fields, **values: object) -> Payload:
    """The payload of a message from named values in wire units; what is not named is zero."""
    return Payload(fields.msgid, fields.crc_extra, fields.pack(**values))


def frame(message: Payload, sysid: int, compid: int, seq: int, incompat: int = 0) -> bytes:
    """The MAVLink 2 packet of a payload, its trailing zeros cut off; `seq` is taken modulo 256.

    `incompat` are the incompatibility flags, `signing.SIGNED` for a packet that will be signed.
    """
    body = message.body.rstrip(b"\0") or b"\0"
    low, high = message.msgid & 0xFFFF, message.msgid >> 16
    packet = _HEADER.pack(_STX, len(body), incompat, 0, seq & 0xFF, sysid, compid, low, high) + body
    crc = crc16.mcrf4xx(bytes((message.crc_extra,)), crc16.mcrf4xx(packet[1:]))
    return packet + crc.to_bytes(2, "little")


def boot_ms(t_us: int) -> int:
    """The boot milliseconds of a boot stamp, modulo 2^32."""
    return t_us // 1000 % 2**32


def deg_e7(angle: float) -> float:
    """Radians -> 1e-7 degrees."""
    return math.degrees(angle) * 1e7


def heading_cdeg(angle: float) -> int:
    """A heading in radians -> centidegrees in [0, 36000)."""
    return round(math.degrees(angle) * 100.0) % 36000 if math.isfinite(angle) else 0


def highres_imu(
    sample: ImuSample, fields_updated: int = ACCEL_AND_GYRO, imu_id: int = 0
) -> Payload:
    """HIGHRES_IMU of one sample (m/s^2, rad/s)."""
    ax, ay, az = sample.accel_b.tolist()
    gx, gy, gz = sample.gyro_b.tolist()
    return payload(
        _HIGHRES_IMU,
        time_usec=sample.t_us,
        xacc=ax,
        yacc=ay,
        zacc=az,
        xgyro=gx,
        ygyro=gy,
        zgyro=gz,
        fields_updated=fields_updated,
        id=imu_id,
    )


def gps_raw_int(
    fix: GnssFix,
    *,
    eph: float | None = None,
    epv: float | None = None,
    yaw: float | None = None,
    sigma_yaw: float | None = None,
) -> Payload:
    """GPS_RAW_INT of a fix; ground speed and course come from v_l, `eph` and `epv` are dilutions of
    precision.

    A horizontal velocity that is None or NaN, an accuracy or a yaw that is None go out as
    'unknown'.
    """
    speed, course = _U16, _U16
    if fix.v_l is not None and math.isfinite(fix.v_l[0]) and math.isfinite(fix.v_l[1]):
        speed = min(round(math.hypot(fix.v_l[0], fix.v_l[1]) * 100.0), _U16 - 1)
        course = heading_cdeg(math.atan2(fix.v_l[1], fix.v_l[0]))
    return payload(
        _GPS_RAW_INT,
        time_usec=fix.t_us,
        fix_type=fix.fix_type,
        lat=deg_e7(fix.lat),
        lon=deg_e7(fix.lon),
        alt=fix.alt * 1e3,
        eph=_U16 if eph is None else _accuracy(eph, 1e2),
        epv=_U16 if epv is None else _accuracy(epv, 1e2),
        vel=speed,
        cog=course,
        satellites_visible=255 if fix.satellites is None else fix.satellites,
        h_acc=_accuracy(fix.sigma_h, 1e3),
        v_acc=_accuracy(fix.sigma_v, 1e3),
        vel_acc=_accuracy(fix.sigma_speed, 1e3),
        hdg_acc=_accuracy(sigma_yaw, math.degrees(1e5)),
        yaw=0 if yaw is None else heading_cdeg(yaw) or 36000,
    )


def _accuracy(sigma: float | None, scale: float) -> float:
    """An accuracy in wire units, at least 1 where it is known: zero means unknown."""
    return 0 if sigma is None or not math.isfinite(sigma) else max(1.0, sigma * scale)


def global_position_int(
    t_us: int,
    lat: float,
    lon: float,
    alt: float,
    relative_alt: float,
    v_l: Sequence[float] | FloatArray,
    heading: float | None,
) -> Payload:
    """GLOBAL_POSITION_INT: rad, rad, m above mean sea level, m above home, NED m/s, heading rad or
    None.
    """
    return payload(
        _GLOBAL_POSITION_INT,
        time_boot_ms=boot_ms(t_us),
        lat=deg_e7(lat),
        lon=deg_e7(lon),
        alt=alt * 1e3,
        relative_alt=relative_alt * 1e3,
        vx=v_l[0] * 1e2,
        vy=v_l[1] * 1e2,
        vz=v_l[2] * 1e2,
        hdg=_U16 if heading is None else heading_cdeg(heading),
    )


def attitude(
    t_us: int, roll: float, pitch: float, yaw: float, rates: Sequence[float] | FloatArray
) -> Payload:
    """ATTITUDE: Z-Y-X Euler angles in rad, body rates in rad/s."""
    return payload(
        _ATTITUDE,
        time_boot_ms=boot_ms(t_us),
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        rollspeed=rates[0],
        pitchspeed=rates[1],
        yawspeed=rates[2],
    )


def system_time(unix_us: int, boot_us: int) -> Payload:
    """SYSTEM_TIME: microseconds since 1970 (0 = not known) and since boot."""
    return payload(_SYSTEM_TIME, time_unix_usec=unix_us, time_boot_ms=boot_ms(boot_us))


def heartbeat(
    mav_type: int,
    autopilot: int,
    base_mode: int = 0,
    system_status: int = dialect.MAV_STATE_ACTIVE,
    custom_mode: int = 0,
) -> Payload:
    """HEARTBEAT; the numbers are of MAV_TYPE, MAV_AUTOPILOT, MAV_MODE_FLAG and MAV_STATE."""
    return payload(
        _HEARTBEAT,
        type=mav_type,
        autopilot=autopilot,
        base_mode=base_mode,
        system_status=system_status,
        custom_mode=custom_mode,
        mavlink_version=3,
    )


def hil_state_quaternion(
    truth: TruthSample, accel: Sequence[float] | FloatArray, rates: Sequence[float] | FloatArray
) -> Payload:
    """HIL_STATE_QUATERNION of a simulator's truth; true specific force in m/s^2, true rates in
    rad/s.

    The airspeeds are the ground speed: the simulator has no wind.
    """
    airspeed = math.hypot(*truth.v_l) * 1e2
    return payload(
        _HIL_STATE_QUATERNION,
        time_usec=truth.t_us,
        attitude_quaternion=truth.q_lb,
        rollspeed=rates[0],
        pitchspeed=rates[1],
        yawspeed=rates[2],
        lat=deg_e7(truth.lat),
        lon=deg_e7(truth.lon),
        alt=truth.alt * 1e3,
        vx=truth.v_l[0] * 1e2,
        vy=truth.v_l[1] * 1e2,
        vz=truth.v_l[2] * 1e2,
        ind_airspeed=airspeed,
        true_airspeed=airspeed,
        xacc=accel[0] / _STANDARD_GRAVITY * 1e3,
        yacc=accel[1] / _STANDARD_GRAVITY * 1e3,
        zacc=accel[2] / _STANDARD_GRAVITY * 1e3,
    )
