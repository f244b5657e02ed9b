"""Payload values -> SI for the messages of GNSS receivers."""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias, TypeVar

from mavins.mavlink.codec.checks import (
    STAMP_LIMIT,
    U16,
    U32,
    check,
    course,
    finite,
    heading,
    known,
    position,
    speed_in_range,
)
from mavins.mavlink.codec.messages import Gps2Raw, GpsInput, GpsRaw, HilGps

Values: TypeAlias = tuple[Any, ...]
Receiver = TypeVar("Receiver", bound=GpsRaw)

_IGNORE_ALT: Final = 1
_IGNORE_HDOP: Final = 2
_IGNORE_VDOP: Final = 4
_IGNORE_VEL_HORIZ: Final = 8
_IGNORE_VEL_VERT: Final = 16
_IGNORE_SPEED_ACC: Final = 32
_IGNORE_HORIZ_ACC: Final = 64
_IGNORE_VERT_ACC: Final = 128


def gps_raw_int(v: Values) -> GpsRaw:
    """The first receiver."""
    return _raw(GpsRaw, v)


def gps2_raw(v: Values) -> Gps2Raw:
    """The second receiver: the same fields in another order, and those of differential corrections."""
    stamp, lat, lon, alt, _, eph, epv, vel, cog, fix, sats, _, yaw, alt_ellipsoid, *sigmas = v
    quality = (eph, epv, vel, cog, fix, sats, alt_ellipsoid, *sigmas, yaw)
    return _raw(Gps2Raw, (stamp, lat, lon, alt, *quality))


def _raw(kind: type[Receiver], v: Values) -> Receiver:
    """From the values of GPS_RAW_INT, in their order there."""
    stamp, lat, lon, alt, eph, epv, vel, cog, fix, sats, _, h_acc, v_acc, vel_acc, hdg_acc, yaw = v
    check(stamp < STAMP_LIMIT, "stamp out of range")
    lat_rad, lon_rad = position(lat, lon, alt * 1e-3, fix)
    return kind(
        stamp_us=stamp,
        fix_type=fix,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        speed=None if vel == U16 else vel * 1e-2,
        course=course(cog),
        satellites=None if sats == 255 else sats,
        eph=known(eph, U16, 1e-2),
        epv=known(epv, U16, 1e-2),
        h_acc=known(h_acc, U32, 1e-3),
        v_acc=known(v_acc, U32, 1e-3),
        vel_acc=known(vel_acc, U32, 1e-3),
        hdg_acc=known(hdg_acc, U32, math.radians(1e-5)),
        yaw=heading(yaw),
    )


def gps_input(v: Values) -> GpsInput:
    """A receiver that another component speaks for."""
    (stamp, _, lat, lon, alt, hdop, vdop, vn, ve, vd, vel_acc, h_acc, v_acc) = v[:13]
    ignore, _, gps_id, fix, sats, yaw = v[13:]

    def used(value: float, flag: int) -> float | None:
        if ignore & flag:
            return None
        finite(value)
        return value

    def accuracy(value: float, flag: int) -> float | None:
        return value if not ignore & flag and 0.0 < value < U16 else None

    check(stamp < STAMP_LIMIT, "stamp out of range")
    altitude = used(alt, _IGNORE_ALT)
    lat_rad, lon_rad = position(lat, lon, altitude or 0.0, fix)
    v_n, v_e = (math.nan, math.nan) if ignore & _IGNORE_VEL_HORIZ else (vn, ve)
    v_d = math.nan if ignore & _IGNORE_VEL_VERT else vd
    speed_in_range(*([] if ignore & _IGNORE_VEL_HORIZ else [v_n, v_e]))
    speed_in_range(*([] if ignore & _IGNORE_VEL_VERT else [v_d]))
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
        yaw=heading(yaw),
    )


def hil_gps(v: Values) -> HilGps:
    """A simulated receiver."""
    stamp, lat, lon, alt, eph, epv, _, vn, ve, vd, _, fix, sats, gps_id, yaw = v
    check(stamp < STAMP_LIMIT, "stamp out of range")
    lat_rad, lon_rad = position(lat, lon, alt * 1e-3, fix)
    return HilGps(
        stamp_us=stamp,
        gps_id=gps_id,
        fix_type=fix,
        lat=lat_rad,
        lon=lon_rad,
        alt=alt * 1e-3,
        v_l=(vn * 1e-2, ve * 1e-2, vd * 1e-2),
        satellites=None if sats == 255 else sats,
        eph=known(eph, U16, 1e-2),
        epv=known(epv, U16, 1e-2),
        yaw=heading(yaw),
    )
