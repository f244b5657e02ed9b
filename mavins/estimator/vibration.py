"""How much the accelerometer shakes, and how often it was at its limit. Theory: docs/theory/vibration.md."""

from __future__ import annotations

import math
from typing import Final, Protocol

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray, IntArray

FLOOR_HZ: Final = 5.0
"""Slower than this is motion of the vehicle."""
LEVEL_HZ: Final = 2.0
"""The squares of what is faster are averaged over about 1 / (2 pi LEVEL_HZ)."""
CLIP: Final = 15.5 * 9.80665
"""m/s^2 on one axis; the usual accelerometer of an autopilot ends at 16 g."""
_RESTART_S: Final = 1.0


@kernel
def shake(state: FloatArray, t_us: IntArray, imu: FloatArray) -> int:
    """Walk rows [gyro_b, accel_b] (N, 6) through `state` (7,) = [t, floor, mean square]; returns how many clipped.

    One-pole filters with the rows' own intervals, so that the outcome does not depend on how rows are grouped.
    """
    clipped = 0
    for k in range(len(t_us)):
        dt = 1e-6 * (t_us[k] - state[0])
        restart = dt <= 0.0 or dt > _RESTART_S
        slow = dt / (dt + 0.5 / (math.pi * FLOOR_HZ))
        mean = dt / (dt + 0.5 / (math.pi * LEVEL_HZ))
        state[0] = t_us[k]
        at_limit = False
        for i in range(3):
            a = imu[k, 3 + i]
            at_limit |= abs(a) >= CLIP
            if restart:
                state[1 + i] = a
                state[4 + i] = 0.0
            else:
                state[1 + i] += slow * (a - state[1 + i])
                fast = a - state[1 + i]
                state[4 + i] += mean * (fast * fast - state[4 + i])
        clipped += at_limit
    return clipped


class ImuRowSource(Protocol):
    """As much of an estimator as `Vibration` looks at."""

    @property
    def t_us(self) -> int | None:
        """The newest IMU stamp, or None."""

    def imu_after(self, t_us: int) -> tuple[IntArray, FloatArray]:
        """The IMU rows that are newer than t_us."""


class Vibration:
    """The vibration of one IMU; it looks at an estimator's rows now and then, at least once a second."""

    def __init__(self) -> None:
        self.clipped = 0
        self._state = np.zeros(7)
        self._seen_us = -1

    @property
    def level(self) -> tuple[float, float, float]:
        """The standard deviation above FLOOR_HZ on each axis of b, m/s^2."""
        x, y, z = np.sqrt(self._state[4:7]).tolist()
        return x, y, z

    def look(self, rows: ImuRowSource) -> None:
        """Take the rows that came since the last look."""
        newest = rows.t_us
        if newest is None:
            return
        if newest < self._seen_us:
            self._seen_us = -1  # the vehicle has rebooted
        t_us, imu = rows.imu_after(self._seen_us)
        if len(t_us):
            self._seen_us = newest
            self.clipped += shake(self._state, t_us, imu)
