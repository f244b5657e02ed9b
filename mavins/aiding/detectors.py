"""Zero-velocity detectors: from a window of IMU rows to one number that is small while the sensor stands.

With W rows of rate w and specific force f, their mean f_mean, and the noises sigma_w, sigma_f of one row:

    SHOE = mean(|f - g f_mean / |f_mean||^2) / sigma_f^2 + mean(|w|^2) / sigma_w^2
    ARED = mean(|w|^2) / sigma_w^2      AMVD = mean(|f - f_mean|^2) / sigma_f^2      MAG = mean((|f| - g)^2) / sigma_f^2

A threshold on them is either a constant or `thresholds`, which follow the gait. Sources: Skog, Handel, Nilsson and
Rantakokko (2010), equations 10 to 17; Wahlstrom and Skog (2021), section IV. Theory: docs/theory/zero_velocity.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray, GnssFix, IntArray

SHOE, ARED, AMVD, MAG = range(4)
KINDS: Final = {"shoe": SHOE, "ared": ARED, "amvd": AMVD, "mag": MAG}
"""Name -> number of each detector that works on IMU rows."""


@kernel
def _mean_square_rate(imu: FloatArray, first: int, end: int) -> float:
    total = 0.0
    for k in range(first, end):
        total += imu[k, 0] * imu[k, 0] + imu[k, 1] * imu[k, 1] + imu[k, 2] * imu[k, 2]
    return total / (end - first)


@kernel
def _mean_force(imu: FloatArray, first: int, end: int) -> tuple[float, float, float]:
    x = y = z = 0.0
    for k in range(first, end):
        x += imu[k, 3]
        y += imu[k, 4]
        z += imu[k, 5]
    n = end - first
    return x / n, y / n, z / n


@kernel
def _mean_square_force(
    imu: FloatArray, first: int, end: int, x: float, y: float, z: float
) -> float:
    """Mean of |f - (x, y, z)|^2."""
    total = 0.0
    for k in range(first, end):
        total += (imu[k, 3] - x) ** 2 + (imu[k, 4] - y) ** 2 + (imu[k, 5] - z) ** 2
    return total / (end - first)


@kernel
def statistic(
    kind: int, imu: FloatArray, first: int, end: int, sigma_f: float, sigma_w: float, g: float
) -> float:
    """The statistic of rows `first` to `end` (exclusive) of imu (N, 6), rows [w, f] in rad/s and m/s^2."""
    if kind == ARED:
        return _mean_square_rate(imu, first, end) / (sigma_w * sigma_w)
    if kind == MAG:
        total = 0.0
        for k in range(first, end):
            f = math.sqrt(imu[k, 3] ** 2 + imu[k, 4] ** 2 + imu[k, 5] ** 2)
            total += (f - g) * (f - g)
        return total / (end - first) / (sigma_f * sigma_f)
    x, y, z = _mean_force(imu, first, end)
    if kind == AMVD:
        return _mean_square_force(imu, first, end, x, y, z) / (sigma_f * sigma_f)
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        s = g / length
        force = _mean_square_force(imu, first, end, s * x, s * y, s * z)
    else:
        # without a mean every direction is as good
        force = _mean_square_force(imu, first, end, 0.0, 0.0, g)
    return force / (sigma_f * sigma_f) + _mean_square_rate(imu, first, end) / (sigma_w * sigma_w)


@kernel
def statistics(
    kind: int, imu: FloatArray, window: int, sigma_f: float, sigma_w: float, g: float
) -> FloatArray:
    """(N,): at each row of imu (N, 6) the statistic of the window that ends there, shorter at the start of the log."""
    out = np.empty(imu.shape[0])
    for k in range(imu.shape[0]):
        out[k] = statistic(kind, imu, max(0, k + 1 - window), k + 1, sigma_f, sigma_w, g)
    return out


@kernel
def threshold(
    t_us: IntArray, values: FloatArray, k: int, memory_us: int, share: float, floor: float
) -> float:
    """The threshold at row k, from the statistics `values` (N,) of the rows within memory_us before t_us[k].

    max(floor, low^(1 - share) high^share): in the logarithm, a fixed share of the way from the quietest to the
    wildest moment of the last step or two.
    """
    low = high = values[k]
    j = k - 1
    while j >= 0 and t_us[k] - t_us[j] <= memory_us:
        low = min(low, values[j])
        high = max(high, values[j])
        j -= 1
    limit: float = low ** (1.0 - share) * high**share
    return max(floor, limit)


@kernel
def thresholds(
    t_us: IntArray, values: FloatArray, memory_us: int, share: float, floor: float
) -> FloatArray:
    """(N,): the threshold at every row, each from that row and those before it."""
    out = np.empty(len(values))
    for k in range(len(values)):
        out[k] = threshold(t_us, values, k, memory_us, share, floor)
    return out


@dataclass(frozen=True, slots=True)
class Detector:
    """A statistic of the last `window` IMU rows; `sigma_accel` m/s^2 and `sigma_gyro` rad/s are of one row."""

    kind: str = "shoe"
    window: int = 5
    sigma_accel: float = 0.01
    sigma_gyro: float = math.radians(0.1)
    gravity: float = 9.81

    def statistics(self, imu: FloatArray) -> FloatArray:
        """(N,) of a whole log imu (N, 6), each from its row and those before it."""
        out: FloatArray = statistics(
            KINDS[self.kind],
            imu,
            self.window,
            self.sigma_accel,
            self.sigma_gyro,
            self.gravity,
        )
        return out

    def latest(self, imu: FloatArray) -> float:
        """The last of `statistics(imu)`, from the last rows alone."""
        rows = imu[-self.window :]
        noises = (self.sigma_accel, self.sigma_gyro, self.gravity)
        return float(statistic(KINDS[self.kind], rows, 0, len(rows), *noises))


@dataclass(frozen=True, slots=True)
class AdaptiveThreshold:
    """A threshold that follows the gait: between stance and swing of the last `memory` seconds, but at least `floor`.

    The defaults go with the defaults of `Detector`. In a walk the foot is nearly still at each step; in a run it
    never is, and a constant that fits the one misses the other's steps or takes its swing for standing.
    """

    memory: float = 1.0
    share: float = 0.4
    floor: float = 1e4

    def over_log(self, t_us: IntArray, values: FloatArray) -> FloatArray:
        """(N,) for the statistics `values` (N,) of rows at t_us (N,)."""
        out: FloatArray = thresholds(t_us, values, self._memory_us, self.share, self.floor)
        return out

    def latest(self, t_us: IntArray, values: FloatArray) -> float:
        """The last of `over_log`; rows that are older than the memory may be left out."""
        last = len(values) - 1
        return float(threshold(t_us, values, last, self._memory_us, self.share, self.floor))

    @property
    def _memory_us(self) -> int:
        return round(self.memory * 1e6)


def gnss_speed(fix: GnssFix) -> float:
    """The GNSS detector's statistic: the horizontal speed in m/s, nan where the fix has none."""
    return math.nan if fix.v_l is None else math.hypot(fix.v_l[0], fix.v_l[1])
