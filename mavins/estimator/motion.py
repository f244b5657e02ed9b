"""The attitude that motion shows: the filters of yaw_gsf.py, fed from the IMU buffer and GNSS velocities.

It goes from fix to fix at its own pace, in the order of arrival, and is never taken back; a fix older than the last
one is left out. Theory: docs/theory/yaw_without_magnetometer.md.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np

from mavins.estimator.alignment import level
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.settings import Settings
from mavins.estimator.standing import mean_rows
from mavins.estimator.yaw_gsf import HYPOTHESES, SPACING, STATES, advance, follow, moments, spread
from mavins.nav.so3 import euler_to_quat, quat_mul, quat_to_euler
from mavins.types import FloatArray, GnssFix

TRUSTED_SIGMA: Final = SPACING / 3.0
"""The sum has settled on one of its filters."""
BIAS_TIME: Final = 10.0
"""A gyro bias that is not known is taken for a noise that is as large after so many seconds."""
_CONSISTENT: Final = 5.0
"""The yaw is trusted up to this mean NIS of two rows."""
_UP: Final = np.array([0.0, 0.0, -9.81])


class MotionAttitude(NamedTuple):
    """q_lb (4,) with its yaw, and the sigmas of yaw and tilt, in rad; `trusted` where the yaw may be used."""

    q_lb: FloatArray
    yaw: float
    sigma: float
    sigma_tilt: float
    trusted: bool


class MotionHeading:
    """One run of the filters, from the first fix with a velocity on; `b_g` (3,) is the gyro bias that it takes out."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._lever_b = np.array(settings.gnss.lever_arm)
        self._buffer_us = round(settings.estimator.buffer * 1e6)
        self._sigma_b_g = settings.imu.gyro_bias_sigma
        self.b_g = np.zeros(3)
        self._clock = np.full(2, -1, dtype=np.int64)
        """Where the attitude is, and the last fix, in us."""
        self._u = np.zeros(6)
        self._q_hb = np.zeros(4)
        self._force_h = np.zeros(3)
        self._x = np.zeros((HYPOTHESES, STATES))
        self._P = np.zeros((HYPOTHESES, STATES, STATES))
        self._log_w = np.zeros(HYPOTHESES)
        self._nis = 0.0
        self._fixes: list[tuple[int, float, float, float]] = []

    def see_fix(self, fix: GnssFix, t_us: int, sigma: float) -> None:
        """A fix that nothing speaks against, valid at t_us, with the sigma of its velocity."""
        if fix.v_l is not None and not math.isnan(fix.v_l[0] + fix.v_l[1]):
            insort(self._fixes, (t_us, fix.v_l[0], fix.v_l[1], sigma))

    def rest(self, gyro_b: FloatArray) -> None:
        """The vehicle stands, and its gyro shows this."""
        self.b_g = gyro_b
        self._sigma_b_g = self.settings.zero_velocity.rate_sigma

    def step(self, buffer: ImuBuffer, now_us: int, asked: bool = True) -> None:
        """Fuse what is not later than `now_us`, the newest stamp.

        Unless `asked`, only where IMU rows will soon be lost: many fixes at once cost little more than one.
        """
        oldest_us = now_us - self._buffer_us
        if not asked and self._clock[0] >= oldest_us:
            return
        while self._fixes and self._fixes[0][0] <= now_us and self._clock[1] < 0:
            t_us, v_n, v_e, sigma = self._fixes.pop(0)
            self._begin(buffer, t_us, np.array([v_n, v_e]), sigma)
        ready = bisect_right(self._fixes, now_us, key=itemgetter(0))
        if ready:
            self._follow(buffer, np.array(self._fixes[:ready]))
            del self._fixes[:ready]
        if 0 <= self._clock[0] < oldest_us:
            self._walk(buffer, oldest_us, self._q_hb, self._force_h, self._u)
            self._clock[0] = oldest_us

    def at(self, buffer: ImuBuffer, t_us: int) -> MotionAttitude | None:
        """The attitude at an instant after the last fix and not after the newest row; None where there is none."""
        if self._clock[1] < 0 or t_us < self._clock[0]:
            return None
        q_hb, force_h, u = self._q_hb.copy(), self._force_h.copy(), self._u.copy()
        self._walk(buffer, t_us, q_hb, force_h, u)
        psi, sigma, tilt = moments(self._x, self._P, self._log_w)
        sigma = math.hypot(sigma, math.sqrt(self._turn_psd() * (t_us - int(self._clock[1])) * 1e-6))
        q_lb = quat_mul(euler_to_quat(0.0, 0.0, psi), q_hb)
        trusted = sigma < TRUSTED_SIGMA and self._nis < _CONSISTENT
        return MotionAttitude(q_lb, float(quat_to_euler(q_lb)[2]), sigma, tilt, trusted)

    def _begin(self, buffer: ImuBuffer, t_us: int, v: FloatArray, sigma: float) -> None:
        window_us = round(self.settings.alignment.window * 1e6)
        first = buffer.row_after(t_us - window_us)
        end = buffer.row_after(t_us)
        if end == first or t_us - buffer.oldest_us < window_us:
            return
        self._q_hb = level(mean_rows(buffer.readings(first, end))[3:], _UP, 0.0)
        self._u = buffer.reading_at(t_us)
        self._clock[:] = t_us
        spread(self._x, self._P, self._log_w, v, sigma)

    def _follow(self, buffer: ImuBuffer, fixes: FloatArray) -> None:
        """Fuse fixes (K, 4): stamp in us, v_n, v_e, sigma."""
        fix_us = fixes[:, 0].astype(np.int64)
        first = buffer.row_after(int(self._clock[0]))
        end = min(buffer.row_after(int(fix_us[-1]) - 1) + 1, buffer.end)
        self._nis = follow(
            self._x,
            self._P,
            self._log_w,
            self._q_hb,
            self._force_h,
            self._u,
            self.b_g,
            self._lever_b,
            np.array([self.settings.imu.accel_noise**2, self._turn_psd()]),
            self._clock,
            self._nis,
            buffer.times(first, end),
            buffer.readings(first, end),
            fix_us,
            fixes[:, 1:].copy(),
        )

    def _walk(
        self, buffer: ImuBuffer, t_us: int, q_hb: FloatArray, force_h: FloatArray, u: FloatArray
    ) -> None:
        start_us = int(self._clock[0])
        first = buffer.row_after(start_us)
        end = min(buffer.row_after(t_us - 1) + 1, buffer.end)
        times, readings = buffer.times(first, end), buffer.readings(first, end)
        advance(q_hb, force_h, u, self.b_g, start_us, times, readings, t_us)

    def _turn_psd(self) -> float:
        """The variance in rad^2 that noise and an unknown bias of the gyro add to an angle in a second."""
        return self.settings.imu.gyro_noise**2 + self._sigma_b_g**2 * BIAS_TIME
