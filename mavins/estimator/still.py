"""Where a foot, a wheel or a tool stands in between: the detectors of aiding/detectors.py on the IMU rows of the last
tick. For vehicles that stand before their first motion only, estimator/standing.py is the safer way.

Theory: docs/theory/zero_velocity.md.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavins.aiding.detectors import AdaptiveThreshold, Detector
from mavins.estimator.aiding_settings import ZeroVelocitySettings
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.imu_rows import TICK_US
from mavins.estimator.standing import StandingDetector, mean_rows
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.types import FloatArray, IntArray

EVERY_US: Final = 50_000
"""While the sensor stands, it is said so no oftener than this: windows that overlap say the same twice."""
SPEED_AGE_US: Final = 1_500_000
"""An older GNSS speed says nothing about now."""


class Still(NamedTuple):
    """An instant of standing, in the middle of its window, with the mean gyro reading (3,) of the window."""

    t_us: int
    gyro_b: FloatArray


class StillDetector:
    """Judged at every tick over the rows that came since the last one."""

    def __init__(self, settings: ZeroVelocitySettings) -> None:
        self._kind = settings.detector
        self._window_us = round(settings.window * 1e6)
        self._noises = (settings.sigma_accel, settings.sigma_gyro)
        self._limit = settings.threshold
        self._speed_limit = settings.speed_limit
        self._adaptive = AdaptiveThreshold()
        self._last_us = -EVERY_US

    def tick(
        self, buffer: ImuBuffer, now_us: int, frame: TangentFrame, seen: StandingDetector
    ) -> list[Still]:
        """The instants of the last tick at which the sensor stood, at least EVERY_US apart; `seen` knows the speed."""
        if seen.speed >= self._speed_limit:
            return []
        if self._kind == "gnss_speed" and (
            seen.speed_us is None or now_us - seen.speed_us > SPEED_AGE_US
        ):
            return []
        memory_us = round(self._adaptive.memory * 1e6)
        start = buffer.row_after(now_us - TICK_US - memory_us - self._window_us)
        t_us, imu = buffer.times(start, buffer.end), buffer.readings(start, buffer.end)
        rows = int(np.searchsorted(t_us, now_us - self._window_us))
        window = len(t_us) - rows
        # a threshold that follows the gait must have seen one step
        young = self._limit == "auto" and now_us - int(t_us[0]) < memory_us + TICK_US
        if window < 2 or rows < window or young:
            return []
        g = float(np.linalg.norm(gravity_n(np.zeros(3), frame.r0_e, frame.C_ne)))
        standing = self._standing(t_us, imu, window, g)
        found = []
        for k in np.flatnonzero(standing & (t_us > now_us - TICK_US)).tolist():
            middle_us = int(t_us[k - window // 2])
            if middle_us - self._last_us >= EVERY_US or middle_us < self._last_us:
                self._last_us = middle_us
                found.append(Still(middle_us, mean_rows(imu[k + 1 - window : k + 1])[:3]))
        return found

    def _standing(
        self, t_us: IntArray, imu: FloatArray, window: int, g: float
    ) -> NDArray[np.bool_]:
        """Of each row whether the window that ends there stands."""
        if self._kind == "gnss_speed":
            return np.ones(len(t_us), dtype=bool)
        detector = Detector(self._kind, window, *self._noises, g)
        values = detector.statistics(imu)
        # the first windows are short: they lack what a whole one would hold
        values[: window - 1] = values[window - 1]
        limit = self._limit
        return values < (self._adaptive.over_log(t_us, values) if limit == "auto" else limit)


def still_detector(settings: ZeroVelocitySettings) -> StillDetector | None:
    """The detector that the settings choose; None for `start`, which is the aligner's."""
    return None if settings.detector == "start" else StillDetector(settings)
