"""A barometer's altitude brought to the level of GNSS altitudes.

Weather and habit put the zero of a barometer anywhere. The difference to GNSS altitude is tracked beside the filter,
slowly, so that GNSS noise is averaged and the barometer's quick motion remains. Where the filter has the barometer's
bias among its states, only the first difference is taken away, and what of it jumps later. Theory: docs/theory/baro.md.
"""

from __future__ import annotations

import math
from typing import Final

from mavins.estimator.aiding_settings import BaroSettings
from mavins.estimator.spacing import shortest_us
from mavins.types import BaroSample

_PAIR_US: Final = 500_000
"""A fix is compared with a reading no older than this."""
_JUMPED: Final = 3
"""So many differences in a row beyond the gate are a new level, not noise."""


class Barometer:
    """One barometer. `offset` is its reading minus GNSS altitude in m, with the variance of its error.

    With `bias_in_filter` readings are lowered by `base` instead: the first offset, and the jumps since.
    """

    def __init__(self, settings: BaroSettings, bias_in_filter: bool = False) -> None:
        self.settings = settings
        self._bias_in_filter = bias_in_filter
        self._last: BaroSample | None = None
        self._taken_us: int | None = None
        self._compared_us = 0
        self._outside = 0
        self.offset = math.nan
        self.variance = math.inf
        self.base = math.nan

    def see_fix(self, t_us: int, alt: float, sigma: float) -> None:
        """Compare a GNSS altitude valid at `t_us` with the newest reading: a Kalman filter of one state."""
        last, s = self._last, self.settings
        if last is None or abs(t_us - last.t_us) > _PAIR_US:
            return
        difference = last.alt - alt
        noise = sigma**2 + s.sigma**2
        if math.isnan(self.offset):
            self._restart(difference, noise, t_us)
            return
        variance = self.variance + s.drift**2 * max(0, t_us - self._compared_us) * 1e-6
        innovation = difference - self.offset
        if abs(innovation) > s.gate * math.sqrt(variance + noise):
            self._outside += 1
            if self._outside >= _JUMPED:
                self._restart(difference, noise, t_us)
            return
        gain = variance / (variance + noise)
        self.offset += gain * innovation
        self.variance = (1.0 - gain) * variance
        self._compared_us = t_us
        self._outside = 0

    def altitude(self, sample: BaroSample) -> tuple[float, float] | None:
        """(altitude in m at the level of GNSS, 1-sigma), or None where it is not known or it is too soon."""
        if not self.settings.enabled or not math.isfinite(sample.alt):
            return None
        self._last = sample
        period_us = shortest_us(self.settings.max_rate)
        if math.isnan(self.offset) or (
            self._taken_us is not None and abs(sample.t_us - self._taken_us) < period_us
        ):
            return None
        self._taken_us = sample.t_us
        if self._bias_in_filter:
            return sample.alt - self.base, self.settings.sigma
        return sample.alt - self.offset, math.sqrt(self.settings.sigma**2 + self.variance)

    def _restart(self, difference: float, noise: float, t_us: int) -> None:
        first = math.isnan(self.offset)
        self.base = difference if first else self.base + difference - self.offset
        self.offset, self.variance = difference, noise
        self._compared_us = t_us
        self._outside = 0
