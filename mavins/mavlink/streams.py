"""Which messages tell of a vehicle's estimate, when each is due, and what is in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Final

from mavins.estimator.estimator import Estimator
from mavins.mavlink.codec import (
    Payload,
    attitude_from,
    attitude_quaternion,
    estimator_status,
    global_position_from,
    gps_global_origin,
    highres_imu_from,
    home_position,
    local_position_ned,
    odometry,
    sys_status,
)
from mavins.mavlink.settings import StreamSettings
from mavins.types import FloatArray, Health, NavSolution, Origin

_GYRO: Final = 0x01
_ACCEL: Final = 0x02
_MAG: Final = 0x04
_GPS: Final = 0x20
_AHRS: Final = 0x200000
_GEOFENCE: Final = 0x100000
"""MAV_SYS_STATUS_SENSOR bits. Ground stations ask for magnetometer health before they call a vehicle healthy (our
heading source stands in for it), and read a missing geofence bit as a breach."""

_ATTITUDE_OK: Final = 1
_VELOCITY_OK: Final = 2 | 4
_POSITION_OK: Final = 8 | 16 | 32
_CONST_POS: Final = 128
"""ESTIMATOR_STATUS_FLAGS bits."""

ESTIMATOR_TYPE_GPS_INS: Final = 5
"""MAV_ESTIMATOR_TYPE of our ODOMETRY towards ground stations."""


@dataclass(frozen=True, slots=True)
class Home:
    """Where the first estimate was: geodetic, in n, and level ground with the heading there as a quaternion."""

    position: Origin
    p_n: FloatArray
    q: tuple[float, float, float, float]

    @classmethod
    def at(cls, solution: NavSolution) -> Home:
        """Home is here."""
        half = 0.5 * solution.yaw
        place = Origin(solution.lat, solution.lon, solution.alt)
        return cls(place, solution.p_n.copy(), (math.cos(half), 0.0, 0.0, math.sin(half)))

    def message(self, t_us: int) -> Payload:
        """HOME_POSITION."""
        return home_position(self.position, self.p_n, t_us, self.q)


def quality_of(solution: NavSolution) -> int:
    """ODOMETRY.quality: 100 where position is known to a metre or better, less beyond, at least 1."""
    if solution.health != Health.RUNNING:
        return 1
    sigma = math.sqrt(max(solution.P[0, 0], solution.P[1, 1]))
    return max(1, min(100, round(100.0 / max(1.0, sigma))))


def _ratio(estimator: Estimator, aiding: str) -> float:
    statistics = estimator.statistics.get(aiding)
    ratio = statistics.last_ratio if statistics is not None else 0.0
    return ratio if ratio >= 0.0 else 0.0


def estimator_status_of(estimator: Estimator, solution: NavSolution) -> Payload:
    """ESTIMATOR_STATUS of a running estimator."""
    flags = _ATTITUDE_OK
    if solution.health == Health.RUNNING:
        flags |= _VELOCITY_OK | _POSITION_OK
    position = _ratio(estimator, "gnss_position")
    return estimator_status(
        solution,
        flags,
        vel_ratio=_ratio(estimator, "gnss_velocity"),
        pos_horiz_ratio=position,
        pos_vert_ratio=position,
        mag_ratio=_ratio(estimator, "heading"),
    )


def sys_status_of(estimator: Estimator, gnss_seen: bool, silent: bool = False) -> Payload:
    """SYS_STATUS of an estimator, running or not; of a `silent` vehicle no sensor is healthy."""
    present = _GYRO | _ACCEL | _MAG | _AHRS | _GEOFENCE | (_GPS if gnss_seen else 0)
    health = _GEOFENCE if silent else _GYRO | _ACCEL | _GEOFENCE
    if estimator.running and not silent:
        health |= _MAG | _AHRS
        if estimator.health == Health.RUNNING:
            health |= _GPS
    return sys_status(present, present, health)


class Streams:
    """Says which payloads are due as the vehicle's clock moves on."""

    def __init__(self, settings: StreamSettings) -> None:
        rates = {f.name: float(getattr(settings, f.name)) for f in fields(settings)}
        # SYS_STATUS goes by the service's clock: it also tells of a vehicle that has no estimate
        self.sys_status_s = 1.0 / rates["sys_status"] if rates["sys_status"] > 0.0 else None
        self._period_us = {
            name: round(1e6 / rate)
            for name, rate in rates.items()
            if rate > 0.0 and name != "sys_status"
        }
        self._before_us: int | None = None
        self._next_us = 0

    def due(self, estimator: Estimator, home: Home | None) -> Iterator[Payload]:
        """The payloads that fall due at the estimator's newest instant; none before it runs."""
        t_us = estimator.t_us
        if t_us is None or not estimator.running:
            return
        before, self._before_us = self._before_us, t_us
        # the first instant, and the first after a reboot, sends everything
        restarted = before is None or t_us < before
        if t_us < self._next_us and not restarted:
            return
        names = [
            name
            for name, period in self._period_us.items()
            if restarted or t_us // period > (before or 0) // period
        ]
        self._next_us = min(((t_us // p + 1) * p for p in self._period_us.values()), default=t_us)
        if not names:
            return
        solution = estimator.solution()
        if solution is None:
            return
        for name in names:
            payload = _make(name, estimator, solution, home)
            if payload is not None:
                yield payload


_SIMPLE: Final[dict[str, Callable[[NavSolution], Payload]]] = {
    "local_position_ned": local_position_ned,
    "attitude": attitude_from,
    "attitude_quaternion": attitude_quaternion,
    "highres_imu": highres_imu_from,
}
"""What is made of the solution alone."""


def _make(
    name: str, estimator: Estimator, solution: NavSolution, home: Home | None
) -> Payload | None:
    if name in _SIMPLE:
        return _SIMPLE[name](solution)
    if name == "odometry":
        return odometry(solution, ESTIMATOR_TYPE_GPS_INS, quality_of(solution))
    if name == "estimator_status":
        return estimator_status_of(estimator, solution)
    if name == "gps_global_origin" and estimator.frame is not None:
        return gps_global_origin(estimator.frame.origin, solution.t_us)
    if home is None:
        return None
    if name == "global_position_int":
        return global_position_from(solution, home.position.alt)
    if name == "home_position":
        return home.message(solution.t_us)
    return None
