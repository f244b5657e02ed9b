"""The magnetometer's heading: the true yaw in the local level frame with a bias and white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavins.types import FloatArray, HeadingFix, IntArray
from sitl.settings import NonNegative, Rate, Settings


@dataclass(frozen=True, slots=True)
class HeadingSettings(Settings):
    """The heading sensor: white noise and 1-sigma of the bias, which is drawn once, in degrees."""

    rate: Rate = 50
    sigma_deg: NonNegative = 2.0
    bias_deg: NonNegative = 0.0


class Compass:
    """The heading sensor and its bias."""

    def __init__(self, settings: HeadingSettings, rng: np.random.Generator) -> None:
        self._sigma = math.radians(settings.sigma_deg)
        self._bias = math.radians(settings.bias_deg) * rng.standard_normal()

    def measure(
        self, t_us: IntArray, yaw: FloatArray, rng: np.random.Generator
    ) -> tuple[HeadingFix, ...]:
        """The headings at t_us (N,) where the true ones are yaw (N,)."""
        noisy = yaw + self._bias + self._sigma * rng.standard_normal(len(yaw))
        wrapped = np.remainder(noisy + math.pi, 2.0 * math.pi) - math.pi
        return tuple(
            HeadingFix(t, y, self._sigma, "magnetometer")
            for t, y in zip(t_us.tolist(), wrapped.tolist(), strict=True)
        )
