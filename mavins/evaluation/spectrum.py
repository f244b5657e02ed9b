"""The spectrum of an IMU of any length in constant memory: Welch's averaged periodogram.

Theory: docs/theory/findings.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from mavins.types import FloatArray, IntArray

LENGTH: Final = 512
"""Samples of a segment; segments overlap by half."""
_HALF: Final = LENGTH // 2
_WINDOW: Final = np.hanning(LENGTH + 1)[:LENGTH]
_LARGEST_GAP: Final = 8.0
"""A segment with an interval of this many mean intervals is not used."""
_RATES_PER_OCTAVE: Final = 4
MOTION_HZ: Final = 10.0
"""What is slower is taken for the vehicle's motion."""
_TOP: Final = 0.4
"""Of the sampling rate: what is faster, filters have often taken away."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power spectral densities `psd` (F, 6) of gyro (rad/s)^2/Hz and accelerometer (m/s^2)^2/Hz.

    `frequency` (F,) in Hz, along the sensor's axes, the mean over `segments` of a log sampled at `rate` Hz.
    """

    frequency: FloatArray
    psd: FloatArray
    segments: int
    rate: float

    def noise_density(self, highest: float = math.inf) -> FloatArray:
        """Root PSD (6,) of white noise above the vehicle's motion, as the settings have it; nan where it is hidden.

        The median over the frequencies from MOTION_HZ to `highest`: a propeller's lines do not move it. Two-sided,
        because sigma^2 = density^2 / dt.
        """
        top = min(highest, _TOP * self.rate)
        above = (self.frequency >= MOTION_HZ) & (self.frequency <= top)
        if above.sum() < 8:
            return np.full(6, np.nan)
        density: FloatArray = np.sqrt(0.5 * np.median(self.psd[above], axis=0))
        return density


@dataclass(slots=True)
class _Sum:
    power: FloatArray
    interval: float = 0.0
    segments: int = 0


@dataclass(slots=True)
class Welch:
    """Takes blocks of IMU rows (N, 6) and averages the periodograms of their segments.

    A log may change its rate: segments are summed by rate, and the rate with the most of them counts.
    """

    _t_us: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    _rows: FloatArray = field(default_factory=lambda: np.empty((0, 6)))
    _sums: dict[int, _Sum] = field(default_factory=dict)

    def take(self, t_us: IntArray, rows: FloatArray) -> None:
        """Add consecutive rows; what does not fill a segment waits for the next."""
        t_us = np.concatenate([self._t_us, t_us])
        rows = np.concatenate([self._rows, rows])
        n = max(0, (len(t_us) - _HALF) // _HALF)
        for k in range(n):
            at = slice(k * _HALF, k * _HALF + LENGTH)
            self._add(t_us[at], rows[at])
        self._t_us, self._rows = t_us[n * _HALF :], rows[n * _HALF :]

    def _add(self, t_us: IntArray, rows: FloatArray) -> None:
        steps = np.diff(t_us)
        mean = (int(t_us[-1]) - int(t_us[0])) * 1e-6 / (LENGTH - 1)
        if steps.min() <= 0 or steps.max() * 1e-6 > _LARGEST_GAP * mean:
            return
        spectrum = np.fft.rfft((rows - rows.mean(axis=0)) * _WINDOW[:, None], axis=0)
        power = (spectrum.real**2 + spectrum.imag**2) * mean
        key = round(_RATES_PER_OCTAVE * math.log2(1.0 / mean))
        total = self._sums.setdefault(key, _Sum(np.zeros_like(power)))
        total.power += power
        total.interval += mean
        total.segments += 1

    def spectrum(self) -> Spectrum | None:
        """The mean so far; None before the first segment."""
        if not self._sums:
            return None
        total = max(self._sums.values(), key=lambda s: s.segments)
        interval = total.interval / total.segments
        psd = 2.0 * total.power / (total.segments * float(_WINDOW @ _WINDOW))
        frequency: FloatArray = np.arange(LENGTH // 2 + 1) / (LENGTH * interval)
        # the mean was taken away, and the window spreads that over its neighbour
        return Spectrum(frequency[2:], psd[2:], total.segments, 1.0 / interval)
