"""Which messages tell of a vehicle's estimate, when each is due, and what is in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from mavins.estimator.estimator import Estimator
from mavins.estimator.vibration import Vibration
from mavins.mavlink.codec import (
    Payload,
    attitude_from,
    attitude_quaternion,
    attitude_quaternion_cov,
    estimator_status,
    fields_of,
    global_position_from,
    global_position_int_cov,
    gps_global_origin,
    highres_imu_from,
    home_position,
    local_position_ned,
    local_position_ned_cov,
    odometry,
    sys_status,
    system_time,
)
from mavins.mavlink.intake import Intake
from mavins.mavlink.reports import ekf_status_of, extended_sys_state_of, vibration_of
from mavins.nav.earth import TangentFrame
from mavins.types import FloatArray, Health, NavSolution, Origin

_GYRO: Final = 0x01
_ACCEL: Final = 0x02
_MAG: Final = 0x04
_GPS: Final = 0x20
_AHRS: Final = 0x200000
_GEOFENCE: Final = 0x100000
_CHECK: Final = 0x10000000
"""MAV_SYS_STATUS_SENSOR bits. Ground stations ask for magnetometer health before they call a vehicle healthy (our
heading source stands in for it), and read a missing geofence bit as a breach. _CHECK is PREARM_CHECK: nobody should
start with an autopilot that does not know where it is."""

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

    @classmethod
    def of(cls, place: Origin, frame: TangentFrame) -> Home:
        """Home is there, on level ground, with a heading of north for want of another."""
        p_n = frame.from_lla(place.lat, place.lon, place.alt)
        return cls(place, p_n, (1.0, 0.0, 0.0, 0.0))

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


def sys_status_of(
    estimator: Estimator, gnss_seen: bool, silent: bool = False, alarm: bool = False
) -> Payload:
    """SYS_STATUS of an estimator, running or not; of a `silent` vehicle no sensor is healthy.

    With `alarm` (the autopilot's own estimate differs from ours) the check before arming has failed.
    """
    present = _GYRO | _ACCEL | _MAG | _AHRS | _GEOFENCE | _CHECK | (_GPS if gnss_seen else 0)
    health = _GEOFENCE if silent else _GYRO | _ACCEL | _GEOFENCE
    if not alarm:
        health |= _CHECK
    if estimator.running and not silent:
        health |= _MAG | _AHRS
        if estimator.health == Health.RUNNING:
            health |= _GPS
    return sys_status(present, present, health)


class Plan:
    """When each message is due on a clock that moves on, and may start over.

    `period_us` names the messages and their periods in us, in the order in which they are sent.
    """

    def __init__(self, period_us: Mapping[str, int], before_us: int | None = None) -> None:
        self.period_us = dict(period_us)
        self.before_us = before_us
        self._next_us = 0

    def due(self, t_us: int) -> list[str]:
        """The messages that reached a multiple of their period since the last call; all at first and after a reboot."""
        before, self.before_us = self.before_us, t_us
        if before is not None and before <= t_us < self._next_us:
            return []
        periods = self.period_us
        self._next_us = min(((t_us // p + 1) * p for p in periods.values()), default=t_us)
        if before is None or t_us < before:
            return list(periods)
        return [n for n, period in periods.items() if t_us // period > before // period]

    def copy(self) -> Plan:
        """The same plan at the same point of time."""
        return Plan(self.period_us, self.before_us)

    def changed(self, name: str, period_us: int) -> Plan:
        """The same plan with another period for one message; one that is not positive takes it out."""
        periods = self.period_us | {name: period_us}
        return Plan({n: p for n, p in periods.items() if p > 0}, self.before_us)


def plan_of(rates: Mapping[str, float], names: Collection[str]) -> Plan:
    """The plan of those of `names` that have a rate in Hz above 0."""
    return Plan({n: round(1e6 / r) for n, r in rates.items() if r > 0.0 and n in names})


class Subject(Protocol):
    """What messages tell of: one vehicle."""

    estimator: Estimator
    intake: Intake
    home: Home | None
    vibration: Vibration

    @property
    def alarm(self) -> bool:
        """True while the autopilot's own estimate differs from ours."""

    @property
    def silent(self) -> bool:
        """True while the vehicle sends no IMU."""


class Telemetry:
    """The messages about a vehicle at one instant, each made once, on demand."""

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._made: dict[str, Payload | None] = {}
        self._solution: NavSolution | None = None

    def __getitem__(self, name: str) -> Payload | None:
        """The message called `name` (its field in StreamSettings), or None while there is nothing to put into it."""
        if name not in self._made:
            self._made[name] = self._make(name)
        return self._made[name]

    def _make(self, name: str) -> Payload | None:
        if name in OF_SERVICE:
            return OF_SERVICE[name](self._subject)
        if self._solution is None:
            self._solution = self._subject.estimator.solution()
        if self._solution is None:
            return None
        return OF_ESTIMATE[name](self._solution, self._subject)


def _origin(solution: NavSolution, subject: Subject) -> Payload | None:
    frame = subject.estimator.frame
    return None if frame is None else gps_global_origin(frame.origin, solution.t_us)


def _global_position(solution: NavSolution, subject: Subject) -> Payload | None:
    home = subject.home
    return None if home is None else global_position_from(solution, home.position.alt)


def _home(solution: NavSolution, subject: Subject) -> Payload | None:
    return None if subject.home is None else subject.home.message(solution.t_us)


def _global_position_cov(solution: NavSolution, subject: Subject) -> Payload | None:
    home = subject.home
    return None if home is None else global_position_int_cov(solution, home.position.alt)


def _sys_status(subject: Subject) -> Payload:
    gnss_seen = subject.intake.last_fix is not None
    return sys_status_of(subject.estimator, gnss_seen, subject.silent, subject.alarm)


def _system_time(subject: Subject) -> Payload | None:
    t_us = subject.estimator.t_us
    return None if t_us is None else system_time(subject.intake.clock.unix_of(t_us) or 0, t_us)


OF_ESTIMATE: Final[dict[str, Callable[[NavSolution, Subject], Payload | None]]] = {
    "local_position_ned": lambda solution, _: local_position_ned(solution),
    "attitude": lambda solution, _: attitude_from(solution),
    "attitude_quaternion": lambda solution, _: attitude_quaternion(solution),
    "odometry": lambda s, _: odometry(s, ESTIMATOR_TYPE_GPS_INS, quality_of(s)),
    "global_position_int": _global_position,
    "highres_imu": lambda solution, _: highres_imu_from(solution),
    "estimator_status": lambda solution, subject: estimator_status_of(subject.estimator, solution),
    "local_position_ned_cov": lambda solution, _: local_position_ned_cov(solution),
    "attitude_quaternion_cov": lambda solution, _: attitude_quaternion_cov(solution),
    "global_position_int_cov": _global_position_cov,
    "ekf_status_report": lambda _, subject: ekf_status_of(subject.estimator),
    "vibration": lambda _, subject: vibration_of(subject.estimator, subject.vibration),
    "gps_global_origin": _origin,
    "home_position": _home,
}
"""What tells of the estimate, due on the vehicle's clock."""
OF_SERVICE: Final[dict[str, Callable[[Subject], Payload | None]]] = {
    "sys_status": _sys_status,
    "extended_sys_state": lambda subject: extended_sys_state_of(subject.estimator),
    "system_time": _system_time,
}
"""What is told without an estimate too, due on the service's clock."""
MSGIDS: Final = {fields_of(n.upper()).msgid: n for n in (*OF_ESTIMATE, *OF_SERVICE)}
"""Message id -> name of everything that can be streamed or asked for."""
