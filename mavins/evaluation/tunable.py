"""Which settings are tuned, within which bounds, on which scale; and how values get into settings.

Theory: docs/theory/tuning.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np

from mavins.aiding import gnss_position, gnss_velocity, heading
from mavins.estimator.measuring import Measuring
from mavins.estimator.quality import noise_of
from mavins.estimator.settings import Settings
from mavins.evaluation.tape import Tape
from mavins.types import GnssFix, HeadingFix

SettingsT = TypeVar("SettingsT", bound=Settings)

OPEN: Final = 5.0
"""While tuning, gates are so many times wider: noises that are set too small must not shut out what would say so."""
SIGMAS_95: Final = 1.96


@dataclass(frozen=True, slots=True)
class Parameter:
    """A setting that may be tuned, within `low` and `high`; `aiding` must be in the log for it to show.

    On a logarithmic scale the unit of the search is a factor e, on a linear one 0.1. `thinned` is the place in a
    thinning of what it is the noise of.
    """

    path: str
    unit: str
    low: float
    high: float
    aiding: str = ""
    logarithmic: bool = True
    walk: bool = False
    thinned: int = -1

    def inner(self, value: float) -> float:
        """The search's own unbounded coordinate: a sine folds it into the bounds."""
        low, half = self._span()
        share = (self._scaled(value) - low - half) / half
        return half * math.asin(min(max(share, -1.0), 1.0))

    def value(self, inner: float) -> float:
        """What a coordinate stands for."""
        low, half = self._span()
        scaled = low + half * (1.0 + math.sin(inner / half))
        value = math.exp(scaled) if self.logarithmic else 0.1 * scaled
        return min(max(value, self.low), self.high)

    def interval(self, value: float, sigma: float) -> tuple[float, float]:
        """The 95 % interval for a 1-sigma of the scaled value."""
        lower, upper = (self._scaled(value) + s * SIGMAS_95 * sigma for s in (-1.0, 1.0))
        if self.logarithmic:
            return math.exp(max(lower, -700.0)), math.exp(min(upper, 700.0))
        return 0.1 * lower, 0.1 * upper

    def slope(self, inner: float) -> float:
        """d scaled / d inner."""
        return math.cos(inner / self._span()[1])

    def is_at_bound(self, value: float) -> bool:
        """True where the search was stopped by a bound."""
        low, half = self._span()
        return min(self._scaled(value) - low, low + 2.0 * half - self._scaled(value)) < 0.02 * half

    def _scaled(self, value: float) -> float:
        return math.log(value) if self.logarithmic else 10.0 * value

    def _span(self) -> tuple[float, float]:
        low, high = self._scaled(self.low), self._scaled(self.high)
        return low, 0.5 * (high - low)


PARAMETERS: Final = (
    Parameter("imu.gyro_noise", "rad/s/sqrt(Hz)", 1e-6, 1.0),
    Parameter("imu.accel_noise", "m/s^2/sqrt(Hz)", 1e-5, 10.0),
    Parameter("imu.gyro_bias_walk", "rad/s^2/sqrt(Hz)", 1e-8, 1e-2, walk=True),
    Parameter("imu.accel_bias_walk", "m/s^3/sqrt(Hz)", 1e-7, 1.0, walk=True),
    Parameter("gnss.position_sigma", "m", 5e-3, 50.0, gnss_position.NAME, thinned=0),
    Parameter("gnss.altitude_sigma", "m", 5e-3, 100.0, gnss_position.NAME, thinned=0),
    Parameter("gnss.velocity_sigma", "m/s", 2e-3, 10.0, gnss_velocity.NAME, thinned=0),
    Parameter("heading.sigma_deg", "deg", 0.05, 60.0, heading.NAME, thinned=1),
    Parameter("gnss.delay", "s", -0.5, 0.8, gnss_position.NAME, logarithmic=False),
)


def get(settings: Settings, path: str) -> Any:
    """The setting at a dotted path."""
    section, name = path.split(".")
    return getattr(getattr(settings, section), name)


def put(settings: SettingsT, values: dict[str, Any]) -> SettingsT:
    """The settings with others at dotted paths."""
    for path, value in values.items():
        section, name = path.split(".")
        changed = dataclasses.replace(getattr(settings, section), **{name: value})
        settings = dataclasses.replace(settings, **{section: changed})
    return settings


def claims(values: Iterable[str]) -> dict[str, str]:
    """The settings by which tuned sigmas, given by dotted paths, hold instead of what sensors report of themselves."""
    sections = {path.split(".")[0] for path in values if "sigma" in path}
    return {f"{section}.accuracy": "configured" for section in sorted(sections)}


def tuned(settings: SettingsT, values: Mapping[str, float]) -> SettingsT:
    """The settings with tuned values."""
    return put(settings, {**values, **claims(values)})


def opened(settings: SettingsT) -> SettingsT:
    """The settings with wide gates."""
    gates = ("gnss.gate", "heading.gate", "magnetometer.gate", "baro.gate")
    return put(settings, {gate: min(OPEN * get(settings, gate), 100.0) for gate in gates})


def first_values(tape: Tape, parameters: Sequence[Parameter]) -> dict[str, float]:
    """What is in force now: sensors' own accuracies where those are used."""
    settings = tape.settings
    fixes = [noise_of(what, settings.gnss) for _, what in tape.feeds if isinstance(what, GnssFix)]
    of_heading = Measuring(settings, ()).heading_sigma
    yaws = [of_heading(what) for _, what in tape.feeds if isinstance(what, HeadingFix)]
    now: dict[str, float] = {"gnss.delay": tape.delay()}
    if fixes:
        now["gnss.position_sigma"] = float(np.median([noise.h for noise in fixes]))
        now["gnss.altitude_sigma"] = float(np.median([noise.v for noise in fixes]))
        now["gnss.velocity_sigma"] = float(np.median([noise.speed for noise in fixes]))
    if yaws:
        now["heading.sigma_deg"] = math.degrees(float(np.median(yaws)))
    return {p.path: float(now.get(p.path, get(settings, p.path))) for p in parameters}
