"""Which GNSS fixes deserve trust, and how much: the gate before the first use and in flight, and the noise of each."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from mavins.estimator.settings import GnssSettings
from mavins.nav.earth import SEMI_MAJOR
from mavins.types import RTK_FIX_TYPES, GnssFix

_BASELINE_US = 900_000
"""Drift is judged over at least about a second: over less, a fix's noise looks like motion."""


@dataclass(frozen=True, slots=True)
class GnssNoise:
    """1-sigma noises taken for a fix: horizontal and vertical position in m, velocity in m/s."""

    h: float
    v: float
    speed: float


def noise_of(fix: GnssFix, settings: GnssSettings) -> GnssNoise:
    """R = max(reported accuracy, floor), with a default where nothing is reported; or what is configured."""
    if settings.accuracy == "configured":
        return GnssNoise(settings.position_sigma, settings.altitude_sigma, settings.velocity_sigma)
    rtk = fix.fix_type in RTK_FIX_TYPES
    position = settings.rtk_position_floor if rtk else settings.position_floor
    speed = settings.rtk_velocity_floor if rtk else settings.velocity_floor
    return GnssNoise(
        max(settings.position_sigma if fix.sigma_h is None else fix.sigma_h, position),
        max(settings.altitude_sigma if fix.sigma_v is None else fix.sigma_v, position),
        max(settings.velocity_sigma if fix.sigma_speed is None else fix.sigma_speed, speed),
    )


def objection(fix: GnssFix, settings: GnssSettings) -> str:
    """Why this fix by itself must not be used; empty where nothing speaks against it."""
    if fix.fix_type < 3:
        return "no 3D fix"
    if fix.lat == 0.0 and fix.lon == 0.0:
        return "null position"
    if fix.satellites is not None and fix.satellites < settings.min_satellites:
        return "few satellites"
    if fix.sigma_h is not None and fix.sigma_h > settings.max_sigma_h:
        return "horizontal accuracy"
    if fix.sigma_v is not None and fix.sigma_v > settings.max_sigma_v:
        return "vertical accuracy"
    if fix.sigma_speed is not None and fix.sigma_speed > settings.max_sigma_speed:
        return "speed accuracy"
    return ""


def _displacement(a: GnssFix, b: GnssFix) -> tuple[float, float]:
    """North and east metres from a to b; good to a percent over the metres that matter here."""
    d_lon = math.remainder(b.lon - a.lon, 2.0 * math.pi)
    return (b.lat - a.lat) * SEMI_MAJOR, d_lon * SEMI_MAJOR * math.cos(a.lat)


class StartGate:
    """Counts good fixes in a row before the first use; `reason` says what the last bad one lacked."""

    def __init__(self, settings: GnssSettings) -> None:
        self.settings = settings
        self._recent: deque[GnssFix] = deque()
        self.good = 0
        self.reason = "no GNSS fix yet"

    @property
    def passed(self) -> bool:
        """True once enough good fixes have come in a row."""
        return self.good >= self.settings.good_fixes

    def add(self, fix: GnssFix, standing: bool) -> None:
        """Judge one more fix; `standing` is what the IMU says."""
        reason = objection(fix, self.settings) or self._inconsistency(fix, standing)
        if reason:
            self.good = 0
            self.reason = f"GNSS: {reason}"
        else:
            self.good += 1
            self.reason = f"GNSS: {self.good} of {self.settings.good_fixes} good fixes"
        self._recent.append(fix)
        while len(self._recent) > 2 and fix.t_us - self._recent[1].t_us >= _BASELINE_US:
            self._recent.popleft()

    def _inconsistency(self, fix: GnssFix, standing: bool) -> str:
        """What is wrong with a fix of a vehicle whose IMU is quiet.

        One that stands must neither move nor drift; one that moves smoothly must move as its speed says.
        """
        speed = math.hypot(fix.v_l[0], fix.v_l[1]) if fix.v_l is not None else 0.0
        old = self._recent[0] if self._recent else None
        dt = 0.0 if old is None else (fix.t_us - old.t_us) * 1e-6
        if not standing or old is None or dt <= 0.0:
            return ""
        moved_n, moved_e = _displacement(old, fix)
        slack = self.settings.max_standing_drift * dt + 3.0 * noise_of(fix, self.settings).h
        v = fix.v_l or (0.0, 0.0, 0.0)
        if math.hypot(moved_n - v[0] * dt, moved_e - v[1] * dt) > slack:
            return "position and speed disagree"
        if (
            speed > self.settings.max_standing_speed
            and math.hypot(moved_n, moved_e) < 0.3 * speed * dt
        ):
            return "speed while standing"
        return ""
