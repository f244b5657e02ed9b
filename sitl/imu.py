"""The IMU: what gyroscopes and accelerometers make of the true rates and specific forces.

y = saturate(quantize((1 + s) x + b(t) + n)) per axis: scale factor s and turn-on bias drawn once,
b(t) a random walk from there, n white.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mavins.types import FloatArray
from sitl.settings import NonNegative, Positive, Rate, Settings


@dataclass(frozen=True, slots=True)
class TriadSettings(Settings):
    """Three like axes, in rad/s or m/s^2 (`unit`).

    `noise` is white, unit/sqrt(Hz); `bias` the 1-sigma of the turn-on bias; `bias_walk` in
    unit/sqrt(s); `scale_factor` a 1-sigma, without unit; `quantum` the resolution (0: none);
    `full_scale` the largest reading (null: none).
    """

    noise: NonNegative = 0.0
    bias: NonNegative = 0.0
    bias_walk: NonNegative = 0.0
    scale_factor: NonNegative = 0.0
    quantum: NonNegative = 0.0
    full_scale: Positive | None = None


@dataclass(frozen=True, slots=True)
class ImuSettings(Settings):
    """The IMU: its samples are point values or, with `integrate`, means over the interval."""

    rate: Rate = 250
    integrate: bool = False
    gyro: TriadSettings = field(default_factory=TriadSettings)
    accel: TriadSettings = field(default_factory=TriadSettings)


class Triad:
    """Three axes and their present bias."""

    def __init__(self, settings: TriadSettings, rate: int, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rate = rate
        self._bias = settings.bias * rng.standard_normal(3)
        self._gain = 1.0 + settings.scale_factor * rng.standard_normal(3)

    def measure(self, x: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Readings and true biases (N, 3) of consecutive samples whose true values are x (N, 3)."""
        s = self._settings
        white = s.noise * math.sqrt(self._rate) * rng.standard_normal(x.shape)
        steps = s.bias_walk / math.sqrt(self._rate) * rng.standard_normal(x.shape)
        biases: FloatArray = self._bias + np.cumsum(steps, axis=0)
        self._bias = biases[-1]
        y: FloatArray = self._gain * x + biases + white
        if s.quantum > 0.0:
            y = s.quantum * np.round(y / s.quantum)
        if s.full_scale is not None:
            y = np.clip(y, -s.full_scale, s.full_scale)
        return y, biases
