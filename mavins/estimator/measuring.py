"""From what sensors report to what a filter can fuse: valid times, noises, and what speaks against it."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from mavins.aiding import Measurement, baro, gnss_position, gnss_velocity, heading, magnetometer
from mavins.estimator.barometer import Barometer
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.compass import Compass
from mavins.estimator.latency import delay_parameters
from mavins.estimator.quality import GnssNoise
from mavins.estimator.settings import Settings
from mavins.filters import FilterState
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_TAU
from mavins.types import BaroSample, FloatArray, GnssFix, HeadingFix, MagSample, Reading

_NOTHING = np.empty(0)


class Measuring:
    """Makes measurements; holds what a sensor must be held against: the Earth's field, the barometer's level.

    `blocks` is what the filter estimates.
    """

    def __init__(self, settings: Settings, blocks: Collection[str]) -> None:
        self._settings = settings
        self._estimates_delay = "tau" in blocks
        self._estimates_hard_iron = "b_m" in blocks
        self._first_delay = 0.0
        self.compass = Compass(settings.magnetometer)
        self.barometer = Barometer(settings.baro, "b_baro" in blocks)

    def start(self, fix: GnssFix) -> None:
        """The estimate starts from this fix, and takes its delay for the first guess."""
        self._first_delay = fix.delay

    def reconfigure(self, settings: Settings, delay_told: bool) -> None:
        """Go on with other settings; with `delay_told`, the delay of fixes is said to be another one."""
        if settings.magnetometer != self._settings.magnetometer:
            self.compass = Compass(settings.magnetometer)
        self.barometer.settings = settings.baro
        self._settings = settings
        if delay_told:
            self._first_delay = math.nan

    def begins_delay(self, fix: GnssFix) -> bool:
        """True where the delay is to be estimated anew from this fix's on, which is noted."""
        if not self._estimates_delay or not math.isnan(self._first_delay):
            return False
        self._first_delay = fix.delay
        return True

    def fix_time(
        self, fix: GnssFix, state: FilterState | None, frame: TangentFrame | None, buffer: ImuBuffer
    ) -> tuple[int, FloatArray]:
        """When a fix was valid; where the delay is estimated, also what its measurements need (latency.py).

        What one fix's delay is said to differ from another's stays; the estimate is of what they have in common.
        """
        if state is None or frame is None or not self._estimates_delay:
            return fix.t_us - round(fix.delay * 1e6), _NOTHING
        delay = float(state.x[X_TAU]) + fix.delay - self._first_delay
        t_us = fix.t_us - round(delay * 1e6)
        return t_us, delay_parameters(state, frame, buffer, t_us)

    def of_fix(
        self,
        fix: GnssFix,
        t_us: int,
        frame: TangentFrame,
        noise: GnssNoise,
        quality: str,
        delay: FloatArray,
    ) -> list[Measurement]:
        """Position and, where the fix has one, velocity."""
        gate = self._settings.gnss.gate
        position = gnss_position.measure(
            fix, t_us, frame, noise.h, noise.v, gate, quality, delay[:1]
        )
        velocity = gnss_velocity.measure(fix, t_us, frame, noise.speed, gate, quality, delay)
        return [position] if velocity is None else [position, velocity]

    def of(self, reading: Reading, frame: TangentFrame) -> Measurement | None:
        """A reading of another sensor; None where it says nothing."""
        match reading:
            case HeadingFix():
                return self.of_heading(reading, frame)
            case MagSample():
                direction_b = self.compass.direction_b(reading)
                return None if direction_b is None else self.of_field(reading, direction_b, frame)
            case BaroSample():
                level = self.barometer.altitude(reading)
                return None if level is None else self.of_altitude(reading, level, frame)

    def heading_time(self, fix: HeadingFix) -> int:
        """When a heading was valid."""
        return fix.t_us - round(fix.delay * 1e6)

    def heading_sigma(self, fix: HeadingFix) -> float:
        """The 1-sigma noise (rad) taken for a heading."""
        settings = self._settings.heading
        if fix.sigma is None or settings.accuracy == "configured":
            return math.radians(settings.sigma_deg)
        return fix.sigma

    def of_heading(self, fix: HeadingFix, frame: TangentFrame) -> Measurement:
        """A heading."""
        sigma, gate = self.heading_sigma(fix), self._settings.heading.gate
        return heading.measure(fix, self.heading_time(fix), frame, sigma, gate)

    def field_time(self, sample: MagSample) -> int:
        """When a magnetometer's reading was valid."""
        return sample.t_us - round(self._settings.magnetometer.delay * 1e6)

    def of_field(
        self, sample: MagSample, direction_b: FloatArray, frame: TangentFrame
    ) -> Measurement:
        """The direction (3,) of the magnetic field in b."""
        settings = self._settings.magnetometer
        return magnetometer.measure(
            sample.source,
            sample.t_us,
            self.field_time(sample),
            direction_b,
            self.compass.reference_n(frame),
            settings.sigma,
            settings.gate,
            directions=self._estimates_hard_iron,
        )

    def of_altitude(
        self, sample: BaroSample, level: tuple[float, float], frame: TangentFrame
    ) -> Measurement:
        """A barometer's altitude brought to the level of GNSS, with its sigma."""
        settings = self._settings.baro
        t_us = sample.t_us - round(settings.delay * 1e6)
        return baro.measure(
            sample.t_us, t_us, level[0], frame, level[1], settings.gate, sample.source
        )
