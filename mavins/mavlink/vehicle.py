"""One vehicle as the session sees it: who may speak for it, its intake and estimator, and what we say about it."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from mavins.estimator.estimator import Estimator
from mavins.estimator.vibration import Vibration
from mavins.mavlink.autopilot_output import AutopilotOutput
from mavins.mavlink.codec import (
    Frames,
    Payload,
    gps_global_origin,
    gps_raw_int,
    heartbeat,
    statustext,
)
from mavins.mavlink.files import OpenFiles
from mavins.mavlink.intake import Intake
from mavins.mavlink.monitor import Monitor
from mavins.mavlink.parameters import VehicleParameters
from mavins.mavlink.peers import Identity
from mavins.mavlink.settings import Persona, StreamSettings
from mavins.mavlink.streams import OF_ESTIMATE, OF_SERVICE, Home, Plan, Telemetry, plan_of
from mavins.types import GnssFix, Health, Origin

HEARTBEAT_US: Final = 1_000_000
REASON_US: Final = 2_000_000
"""A reason that lasts this long is worth a text."""
MAV_TYPE_AND_AUTOPILOT: Final[dict[Persona, tuple[int, int]]] = {
    "vehicle": (0, 0),
    "companion": (18, 8),
}
"""GENERIC twice, of which ground stations make a vehicle; ONBOARD_CONTROLLER and INVALID, of which they do not."""
MAV_STATE_CRITICAL: Final = 5
_STATE: Final = {
    Health.WAITING: 1,
    Health.ALIGNING: 2,
    Health.RUNNING: 4,
    Health.DEAD_RECKONING: MAV_STATE_CRITICAL,
    Health.DIVERGED: MAV_STATE_CRITICAL,
}
"""Health -> MAV_STATE: boot, calibrating, active, critical."""
_SEVERITY: Final = {
    Health.WAITING: 6,
    Health.ALIGNING: 6,
    Health.RUNNING: 6,
    Health.DEAD_RECKONING: 4,
    Health.DIVERGED: 3,
}
"""Health -> MAV_SEVERITY: info, warning, error."""
_WARNING: Final = 4
_INFO: Final = 6


def _name(health: Health) -> str:
    return health.name.lower().replace("_", " ")


@dataclass(slots=True)
class Holder:
    """The address that speaks for a vehicle, and when it last did (reception, us); None: any may."""

    address: Hashable
    seen_us: int


@dataclass(frozen=True, slots=True)
class Plans:
    """The messages that are due on the vehicle's clock, and those on the service's."""

    of_estimate: Plan
    of_service: Plan

    def with_name(self, name: str) -> Plan:
        """The plan to which a message belongs."""
        return self.of_estimate if name in OF_ESTIMATE else self.of_service

    def changed(self, name: str, period_us: int) -> Plans:
        """Plans of one's own with another period for one message."""
        mine, other = (self.of_estimate, self.of_service)
        if name in OF_ESTIMATE:
            return Plans(mine.changed(name, period_us), other.copy())
        return Plans(mine.copy(), other.changed(name, period_us))


class Due(NamedTuple):
    """What is due: for all peers but those in `own`, which have rates of their own."""

    usual: list[str]
    own: dict[Hashable, list[str]]


@dataclass(slots=True)
class Vehicle:
    """One vehicle. `sysid` is its own, `identity` the one we speak under; `lack` says what it has stopped sending.

    Each peer may have rates of its own.
    """

    sysid: int
    identity: Identity
    estimator: Estimator
    intake: Intake
    holder: Holder
    stream_settings: StreamSettings
    timeout_us: int = 3_000_000
    persona: Persona = "vehicle"
    parameters: VehicleParameters = field(default_factory=VehicleParameters)
    opened: OpenFiles = field(default_factory=OpenFiles)
    monitor: Monitor | None = None
    output: AutopilotOutput | None = None
    vibration: Vibration = field(default_factory=Vibration)
    home: Home | None = None
    lack: str = ""
    _plans: Plans = field(init=False)
    _own_plans: dict[Hashable, Plans] = field(default_factory=dict)
    _imu_us: int = field(init=False)
    _imu_rows: int = 0
    _said: tuple[Health, int, int] = (Health.WAITING, 0, 0)
    _fix: GnssFix | None = None
    _heartbeat_us: int | None = None
    _text_id: int = 0
    _reason: str = ""
    _reason_us: int = 0
    _reason_said: str = ""
    _refusal: str = ""

    def __post_init__(self) -> None:
        self.set_rates(self.stream_settings)
        self._imu_us = self.holder.seen_us

    def take(self, frames: Frames) -> Iterator[Payload]:
        """Feed packets of the vehicle; gives the news that they make, for everybody."""
        self.intake.take(frames)
        yield from self.look(int(frames.t_us[-1]))

    def look(self, now_us: int) -> Iterator[Payload]:
        """The news that there are after something was fed."""
        if self.estimator.imu_rows != self._imu_rows:
            self._imu_rows = self.estimator.imu_rows
            self._imu_us = now_us
        yield from self.news()
        yield from self._fix_news()
        if self.monitor is not None:
            for text, is_warning in self.monitor.texts():
                yield from self.text(text, _WARNING if is_warning else _INFO)

    def tick(self, now_us: int) -> list[Payload]:
        """News by our own clock: HEARTBEAT, and a word when the vehicle falls silent."""
        due = [*self._silence_news(now_us), *self._reason_news(now_us), *self._output_news()]
        self.vibration.look(self.estimator)
        if self._heartbeat_us is None or now_us - self._heartbeat_us >= HEARTBEAT_US:
            self._heartbeat_us = now_us
            state = MAV_STATE_CRITICAL if self.lack else _STATE[self.estimator.health]
            kind, autopilot = MAV_TYPE_AND_AUTOPILOT[self.persona]
            due.append(heartbeat(kind, autopilot, base_mode=0, system_status=state))
        return due

    # ---- streams -----------------------------------------------------------------------------------------------

    def telemetry(self) -> Telemetry:
        """The messages about the vehicle at this instant."""
        return Telemetry(self)

    def set_rates(self, settings: StreamSettings) -> None:
        """The usual rates from now on; peers that asked for rates of their own keep them."""
        rates = settings.rates(self.persona)
        self.stream_settings = settings
        self._plans = Plans(plan_of(rates, OF_ESTIMATE), plan_of(rates, OF_SERVICE))

    def output_due(self) -> Iterable[Payload]:
        """What is due to the vehicle's own autopilot."""
        if self.output is None:
            return ()
        intake = self.intake
        satellites = None if intake.last_fix is None else intake.last_fix.satellites
        return self.output.due(self.estimator, intake.autopilot, satellites)

    def estimate_due(self) -> Due | None:
        """Which messages are due on the vehicle's clock; None before there is an estimate."""
        t_us = self.estimator.t_us
        if t_us is None or not self.estimator.running:
            return None
        names = self._plans.of_estimate.due(t_us)
        if not self._own_plans:
            return Due(names, {}) if names else None
        return Due(names, {a: p.of_estimate.due(t_us) for a, p in self._own_plans.items()})

    def service_due(self, now_us: int) -> Due:
        """Which messages are due on the service's clock."""
        own = {a: plans.of_service.due(now_us) for a, plans in self._own_plans.items()}
        return Due(self._plans.of_service.due(now_us), own)

    def set_interval(self, address: Hashable, name: str, interval_us: int | None) -> None:
        """A peer's own interval for a message: None its usual one, -1 off."""
        usual = self._plans.with_name(name)
        wanted = usual.period_us.get(name, -1) if interval_us is None else interval_us
        plans = self._own_plans.get(address, self._plans)
        if plans.with_name(name).period_us.get(name, -1) != wanted:
            self._own_plans[address] = plans.changed(name, wanted)

    def interval_us(self, address: Hashable, name: str) -> int:
        """How often a peer gets a message; -1: never."""
        plans = self._own_plans.get(address, self._plans)
        return plans.with_name(name).period_us.get(name, -1)

    def sent_to(self, address: Hashable) -> tuple[str, ...]:
        """The messages that a peer gets."""
        plans = self._own_plans.get(address, self._plans)
        return (*plans.of_estimate.period_us, *plans.of_service.period_us)

    def forget_peer(self, address: Hashable) -> None:
        """A peer has gone, and its wishes with it."""
        self._own_plans.pop(address, None)

    # ---- news --------------------------------------------------------------------------------------------------

    def welcome(self) -> list[Payload]:
        """What a new peer is told at once, because it comes seldom otherwise."""
        home, t_us = self.home, self.estimator.t_us
        if home is None or t_us is None or not self.estimator.running:
            return []
        return [home.message(t_us)]

    @property
    def alarm(self) -> bool:
        """True while the autopilot's own estimate differs from ours."""
        return self.monitor is not None and self.monitor.warning

    @property
    def silent(self) -> bool:
        """True while the vehicle sends no IMU."""
        return bool(self.lack)

    def silence(self, now_us: int) -> str:
        """What the vehicle withholds for how long, for people; empty while its IMU samples come."""
        if now_us - self.holder.seen_us > self.timeout_us:
            return f"silent for {(now_us - self.holder.seen_us) * 1e-6:.0f} s"
        if now_us - self._imu_us > self.timeout_us:
            return f"no usable IMU for {(now_us - self._imu_us) * 1e-6:.0f} s"
        return ""

    def _silence_news(self, now_us: int) -> list[Payload]:
        """A text when the vehicle falls silent or stops sending an IMU, and when it is back."""
        lack = self.silence(now_us).partition(" for ")[0]
        if lack == self.lack:
            return []
        self.lack = lack
        return self.text(f"mavins: vehicle {self.sysid} {lack or 'is back'}", 4 if lack else 6)

    def _reason_news(self, now_us: int) -> list[Payload]:
        """A text where there is no estimate, once the same thing has been lacking for a while."""
        reason = "" if self.estimator.running or self.lack else self.estimator.reason
        if reason != self._reason:
            self._reason = reason
            self._reason_us = now_us
        if not reason or reason == self._reason_said or now_us - self._reason_us < REASON_US:
            return []
        self._reason_said = reason
        return self.text(f"mavins {_name(self.estimator.health)}: {reason}", 6)

    def _output_news(self) -> list[Payload]:
        """A text where the user wants the autopilot to get something that it cannot."""
        refusal = "" if self.output is None else self.output.refusal(self.intake.autopilot)
        if refusal == self._refusal:
            return []
        self._refusal = refusal
        return self.text(f"mavins: {refusal}", _WARNING) if refusal else []

    def set_origin(self, origin: Origin) -> list[Payload]:
        """Put the origin of n there; returns the announcement."""
        self.estimator.set_origin(origin)
        self.home = None
        return [gps_global_origin(origin, self.estimator.t_us or 0), *self.news()]

    def news(self) -> list[Payload]:
        """A text for each change of health and each reset, and home once there is an estimate."""
        estimator = self.estimator
        if self.home is None and estimator.running:
            solution = estimator.solution()
            if solution is not None:
                self.home = Home.at(solution)
        before_health, before_resets, before_losses = self._said
        health, resets, losses = (
            estimator.health,
            estimator.reset_counter,
            estimator.realignments,
        )
        if (health, resets, losses) == self._said:
            return []
        self._said = (health, resets, losses)
        texts: list[Payload] = []
        if losses != before_losses:
            texts += self.text(f"mavins estimate lost: {estimator.loss}", 4)
        if health != before_health:
            self._reason_said = estimator.reason
            reason = f": {estimator.reason}" if estimator.reason else ""
            texts += self.text(f"mavins {_name(health)}{reason}", _SEVERITY[health])
        if resets != before_resets:
            texts += self.text(f"mavins estimate reset ({resets})", 4)
        return texts

    def text(self, text: str, severity: int) -> list[Payload]:
        """STATUSTEXT in chunks; `severity` of MAV_SEVERITY."""
        self._text_id += 1
        return statustext(text, severity, self._text_id)

    def _fix_news(self) -> list[Payload]:
        """Each fix once, as GPS_RAW_INT."""
        fix = self.intake.last_fix
        if fix is None or fix is self._fix:
            return []
        self._fix = fix
        return [gps_raw_int(fix)] if self.estimator.running else []
