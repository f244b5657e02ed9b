"""The integrity monitor: does the autopilot's own estimate still agree with ours? Theory: docs/theory/monitor.md.

It sees what the autopilot says of itself, a few times a second of each kind, and holds it against our solution of the
same instant. It depends on packets only and changes no estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mavins.mavlink.autopilot_settings import MonitorSettings
from mavins.mavlink.codec import Attitude, GlobalPosition, LocalPosition, fields_of
from mavins.mavlink.sources import ARDUPILOT, PX4
from mavins.mavlink.track import Instant, Own, Track, tilt_and_yaw
from mavins.nav.so3 import euler_to_quat, wrap_pi
from mavins.status import MonitorStatus

LOOK_US: Final = 190_000
"""At most one message of a kind in this time is looked at: 5 a second, with some slack for jitter."""
GAP_US: Final = 1_000_000
"""After a longer silence of the autopilot its time beyond a limit counts from anew."""
CALM: Final = 0.8
"""A warning ends once the ratio has been below this as long as it takes to begin one."""

_ATTITUDE: Final = fields_of("ATTITUDE").msgid
_WATCHED: Final = frozenset(
    (_ATTITUDE, fields_of("GLOBAL_POSITION_INT").msgid, fields_of("LOCAL_POSITION_NED").msgid)
)


@dataclass(slots=True)
class Quantity:
    """One quantity that is compared: how far the autopilot's is from ours (SI, rad), and since when too far."""

    name: str
    unit: str
    allowed: float
    difference: float = 0.0
    limit: float = math.inf
    warning: bool = False
    looks: int = 0
    warnings: int = 0
    warned_us: int = 0
    worst: tuple[float, float, float, int] = (0.0, 0.0, math.inf, 0)
    """Ratio, difference, limit and time of the worst look."""
    t_us: int = 0
    over_us: int | None = None
    """When it went over its limit, until a warning has ended again."""
    calm_us: int | None = None
    """When, during a warning, it went below CALM of its limit."""

    @property
    def ratio(self) -> float:
        """Difference over limit at the last look."""
        return self.difference / self.limit

    def see(self, t_us: int, difference: float, sigma: float, after_us: int) -> bool:
        """Take a look; True where a warning begins or ends."""
        if t_us - self.t_us > GAP_US:
            self.calm_us = None
            self.over_us = self.over_us if self.warning else None
        elif self.warning:
            self.warned_us += t_us - self.t_us
        self.t_us = t_us
        self.looks += 1
        self.difference, self.limit = difference, self.allowed + sigma
        if self.ratio > self.worst[0]:
            self.worst = (self.ratio, self.difference, self.limit, t_us)
        if self.warning:
            return self._may_end(after_us)
        return self._may_begin(after_us)

    def _may_begin(self, after_us: int) -> bool:
        if self.ratio <= 1.0:
            self.over_us = None
            return False
        if self.over_us is None:
            self.over_us = self.t_us
        self.warning = self.t_us - self.over_us >= after_us
        self.warnings += self.warning
        return self.warning

    def _may_end(self, after_us: int) -> bool:
        if self.ratio >= CALM:
            self.calm_us = None
            return False
        if self.calm_us is None:
            self.calm_us = self.t_us
        return self.t_us - self.calm_us >= after_us and self.forget()

    def forget(self) -> bool:
        """Nothing can be compared any more; True where that ends a warning."""
        ended, self.warning = self.warning, False
        self.over_us = self.calm_us = None
        return ended

    def text(self) -> str:
        """What is said where a warning begins or ends."""
        scale, unit, digits = (
            (math.degrees(1.0), "deg", 0) if self.unit == "rad" else (1.0, self.unit, 1)
        )
        difference = f"{self.difference * scale:.{digits}f} {unit}"
        if self.warning:
            return f"mavins: autopilot {self.name} differs by {difference} (limit {self.limit * scale:.{digits}f})"
        return f"mavins: autopilot {self.name} agrees again, {difference}"


class Monitor:
    """Compares one vehicle's autopilot with one estimator; see `Intake`, which feeds it."""

    def __init__(self, settings: MonitorSettings, own: Own) -> None:
        s = settings
        self._settings = settings
        self._track = Track(own)
        self._after_us = round(settings.after * 1e6)
        self._looked: dict[int, int] = {}
        self._texts: list[tuple[str, bool]] = []
        self.quantities = {
            quantity.name: quantity
            for quantity in (
                Quantity("position", "m", s.position),
                Quantity("height", "m", s.height),
                Quantity("velocity", "m/s", s.velocity),
                Quantity("tilt", "rad", math.radians(s.tilt_deg)),
                Quantity("yaw", "rad", math.radians(s.yaw_deg)),
            )
        }

    # ---- what comes in -----------------------------------------------------------------------------------------

    def wants(self, msgid: int, stamp_us: int, autopilot: int | None) -> bool:
        """True for a packet that is worth decoding: told at a glance, as most are not."""
        if msgid not in _WATCHED:
            return False
        enabled = self._settings.enabled
        if enabled is False or (enabled == "auto" and autopilot not in (ARDUPILOT, PX4)):
            return False
        looked = self._looked.get(msgid)
        return looked is None or abs(stamp_us - looked) >= LOOK_US

    def see(self, msgid: int, message: Any, t_us: int) -> None:
        """Compare one message of the autopilot's, valid at `t_us` on the vehicle's time base."""
        self._looked[msgid] = message.stamp_us
        if not self._track.remember():
            self._forget()
        ours = self._track.at(t_us)
        if ours is None:
            return
        if isinstance(message, Attitude):
            q_lb = euler_to_quat(message.roll, message.pitch, message.yaw)
            tilt, yaw = tilt_and_yaw(q_lb, ours.q_lb)
            self._judge(ours, "tilt", tilt)
            self._judge(ours, "yaw", *self._worse_yaw(ours, yaw))
        elif isinstance(message, GlobalPosition):
            theirs_n = ours.frame.from_lla(message.lat, message.lon, message.alt)
            d_l = ours.c_ln @ (theirs_n - ours.p_n)
            self._judge(ours, "position", math.hypot(d_l[0], d_l[1]))
            self._judge(ours, "height", abs(float(d_l[2])))
            self._judge(ours, "velocity", _distance(message.v_l, ours))
        elif isinstance(message, LocalPosition):
            self._judge(ours, "velocity", _distance(message.v_n, ours))

    def _forget(self) -> None:
        for quantity in self.quantities.values():
            quantity.t_us = 0  # the vehicle's clock may have started again
            if quantity.forget():
                self._texts.append((f"mavins: autopilot {quantity.name} is not compared", False))

    def _judge(
        self, ours: Instant, name: str, difference: float, sigma: float | None = None
    ) -> None:
        quantity = self.quantities[name]
        share = self._settings.sigmas * (ours.sigma[name] if sigma is None else sigma)
        if ours.t_us >= quantity.t_us and quantity.see(
            ours.t_us, difference, share, self._after_us
        ):
            self._texts.append((quantity.text(), quantity.warning))

    def _worse_yaw(self, ours: Instant, yaw: float) -> tuple[float, float]:
        """(difference, sigma) of the autopilot's yaw from ours, or from what motion shows, whichever is worse.

        Our own heading may be the autopilot's: a slow drift of it takes our yaw along, but not that of motion.
        """
        sigmas = [(abs(yaw), ours.sigma["yaw"])]
        if ours.motion is not None:
            sigmas.append((abs(wrap_pi(yaw - ours.motion[0])), ours.motion[1]))
        allowed, share = self.quantities["yaw"].allowed, self._settings.sigmas
        return max(sigmas, key=lambda pair: pair[0] / (allowed + share * pair[1]))

    # ---- what is told ------------------------------------------------------------------------------------------

    @property
    def warning(self) -> bool:
        """True while any quantity differs too much."""
        return any(quantity.warning for quantity in self.quantities.values())

    def texts(self) -> list[tuple[str, bool]]:
        """What was not said yet: (text, True for a warning), in order."""
        texts, self._texts = self._texts, []
        return texts

    def status(self) -> dict[str, MonitorStatus] | None:
        """How each quantity stands, for the live status; None before the first look."""
        seen = {name: q for name, q in self.quantities.items() if q.looks}
        return {name: _status(q) for name, q in seen.items()} or None

    def summary(self) -> dict[str, Any] | None:
        """What was seen in all, in SI units and radians; None where nothing was compared."""
        seen = {name: q for name, q in self.quantities.items() if q.looks}
        return {name: _summary(q) for name, q in seen.items()} or None


def _distance(v_l: tuple[float, float, float], ours: Instant) -> float:
    return float(np.linalg.norm(np.subtract(v_l, ours.v_l)))


def _status(q: Quantity) -> MonitorStatus:
    beyond = 0.0 if q.over_us is None else (q.t_us - q.over_us) * 1e-6
    return MonitorStatus(q.difference, q.limit, q.unit, q.worst[0], beyond, q.warning)


def _summary(q: Quantity) -> dict[str, Any]:
    ratio, difference, limit, t_us = q.worst
    return {
        "looks": q.looks,
        "worst_ratio": ratio,
        "worst_difference": difference,
        "worst_limit": limit,
        "worst_t_us": t_us,
        "unit": q.unit,
        "warnings": q.warnings,
        "warned_s": q.warned_us * 1e-6,
    }
