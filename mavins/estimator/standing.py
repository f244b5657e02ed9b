"""Is the vehicle standing? From the IMU's means over two adjacent windows, and the GNSS speed.

Standing is only ever found before the first motion: in a steady hover an IMU looks the same as on the ground.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.estimator.aiding_settings import ZeroVelocitySettings
from mavins.estimator.buffer import ImuBuffer
from mavins.nav.kernels import kernel
from mavins.types import FloatArray

HALF_WINDOW_US = 250_000
_SETTLED_TICKS = 3


@kernel
def mean_rows(rows: FloatArray) -> FloatArray:
    """The mean (6,) of rows (N, 6), summed in their order."""
    total = np.zeros(6)
    for i in range(rows.shape[0]):
        for j in range(6):
            total[j] += rows[i, j]
    mean: FloatArray = total / rows.shape[0]
    return mean


def _distance(a: FloatArray, b: FloatArray) -> float:
    return math.sqrt(float((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2))


class StandingDetector:
    """Judged at every tick; `standing` and `moved` say what was found."""

    def __init__(self, settings: ZeroVelocitySettings) -> None:
        self.settings = settings
        self.moved = False
        self._reference: FloatArray | None = None
        self._quiet_ticks = 0
        self.speed = 0.0
        self.speed_us: int | None = None
        """The horizontal speed of the last good fix (m/s; 0 before there is one), and when it was valid."""
        self.gyro_b = np.zeros(3)
        """The mean gyro reading of the earlier of both windows at the last look."""

    @property
    def quiet(self) -> bool:
        """True while the IMU shows no motion, whatever GNSS says."""
        return self._quiet_ticks >= _SETTLED_TICKS

    @property
    def standing(self) -> bool:
        """True while the vehicle stands and has not moved since it was first found standing."""
        return self.quiet and not self.moved and self.speed < self.settings.speed_limit

    def see_speed(self, speed: float, t_us: int) -> None:
        """The horizontal speed (m/s) at t_us of a fix that nothing speaks against."""
        self.speed, self.speed_us = speed, t_us
        if self.quiet and speed >= self.settings.speed_limit:
            self.moved = True

    def tick(self, buffer: ImuBuffer, now_us: int) -> None:
        """Look at the half second before `now_us`, the newest stamp."""
        middle = buffer.row_after(now_us - HALF_WINDOW_US)
        start = buffer.row_after(now_us - 2 * HALF_WINDOW_US)
        if middle == start or middle == buffer.end:
            self._disturbed()
            return
        before = mean_rows(buffer.readings(start, middle))
        after = mean_rows(buffer.readings(middle, buffer.end))
        self.gyro_b = before[:3]
        if self._reference is None:
            self._reference = before
        s = self.settings
        for mean in (before, after):
            turning = _distance(mean[:3], self._reference[:3]) > s.gyro_limit
            spinning = _distance(mean[:3], np.zeros(3)) > 3.0 * s.gyro_limit
            pushed = _distance(mean[3:], self._reference[3:]) > s.accel_limit
            if turning or spinning or pushed:
                self._disturbed()
                return
        self._quiet_ticks += 1

    def _disturbed(self) -> None:
        if self.quiet:
            self.moved = True
        self._reference = None
        self._quiet_ticks = 0
