"""Collects what the first state needs, says what is still missing, and makes it when all is there."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavins.estimator.alignment import Start, initial_state
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.compass import Compass, levelled
from mavins.estimator.motion import MotionAttitude, MotionHeading
from mavins.estimator.quality import StartGate, noise_of, objection
from mavins.estimator.settings import Settings
from mavins.estimator.standing import StandingDetector, mean_rows
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import Layout
from mavins.nav.so3 import dcm_to_quat, quat_conj, quat_mul
from mavins.types import FloatArray, GnssFix, HeadingFix

_HISTORY_US = 3_000_000
_DIP_LIMIT = math.radians(30.0)
"""A field whose dip is further from the Earth's than this tells no heading."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """All that a start needs: the fix and its valid time, the heading, IMU means over the window, and the motion.

    `attitude` is that at the fix where motion has shown it, `yaw_by_mag` (3,) what a bias of the magnetic field's
    direction, in l, adds to the heading where that is the field's.
    """

    t_us: int
    fix: GnssFix
    heading: HeadingFix
    gyro_b: FloatArray
    accel_b: FloatArray
    acceleration_l: FloatArray
    standing: bool
    attitude: MotionAttitude | None = None
    yaw_by_mag: FloatArray | None = None


class Aligner:
    """Sees every fix and heading, and looks at the IMU when asked for a candidate."""

    def __init__(self, settings: Settings, compass: Compass | None = None) -> None:
        self._settings = settings
        self._compass = compass or Compass(settings.magnetometer)
        self.standing = StandingDetector(settings.zero_velocity)
        self.gate = StartGate(settings.gnss)
        self.motion = MotionHeading(settings)
        self._fixes: deque[tuple[int, GnssFix]] = deque()
        self._heading: tuple[int, HeadingFix] | None = None
        self._field: tuple[int, FloatArray] | None = None

    def reconfigure(self, settings: Settings, compass: Compass) -> None:
        """Other settings from now on; what has been seen stays."""
        self._settings, self._compass = settings, compass
        self.standing.settings = settings.zero_velocity
        self.gate.settings = settings.gnss
        self.motion.settings = settings

    def see_fix(self, fix: GnssFix, t_us: int) -> None:
        """A fix with its valid time."""
        self.gate.add(fix, self.standing.quiet)
        if objection(fix, self._settings.gnss):
            return
        self._fixes.append((t_us, fix))
        if self._settings.heading.from_motion:
            self.motion.see_fix(fix, t_us, noise_of(fix, self._settings.gnss).speed)
        while t_us - self._fixes[0][0] > _HISTORY_US:
            self._fixes.popleft()

    def see_heading(self, fix: HeadingFix, t_us: int) -> None:
        """A heading with its valid time."""
        self._heading = (t_us, fix)

    def see_field(self, direction_b: FloatArray, t_us: int) -> None:
        """The direction (3,) of the magnetic field in b with its valid time."""
        self._field = (t_us, direction_b)

    def tick(self, buffer: ImuBuffer, now_us: int, asked: bool = True) -> None:
        """Look at the IMU rows up to `now_us`, the newest stamp; `asked` where what motion shows is wanted now."""
        if not self.standing.moved:
            self.standing.tick(buffer, now_us)
        if self.standing.standing:
            self.motion.rest(self.standing.gyro_b)
        self.motion.step(buffer, now_us, asked)

    def from_motion(self, buffer: ImuBuffer, now_us: int, buffer_us: int) -> Candidate | None:
        """A start from the attitude that motion shows; None where it is not to be trusted."""
        usable = [(t, f) for t, f in self._fixes if now_us - buffer_us < t <= now_us]
        attitude = self.motion.at(buffer, usable[-1][0]) if usable else None
        if attitude is None or not attitude.trusted:
            return None
        t_us, fix = usable[-1]
        u = buffer.reading_at(t_us)
        heading = HeadingFix(t_us, attitude.yaw, attitude.sigma, "motion")
        return Candidate(t_us, fix, heading, u[:3], u[3:], np.zeros(3), False, attitude)

    def candidate(self, buffer: ImuBuffer, now_us: int, buffer_us: int) -> Candidate | str:
        """What a start can be made from now, or what is missing for one."""
        settings = self._settings.alignment
        window_us = round(settings.window * 1e6)
        if now_us - buffer.oldest_us < window_us:
            return "collecting IMU samples"
        if not self.gate.passed:
            return self.gate.reason
        told = [seen[0] for seen in (self._heading, self._field) if seen is not None]
        if not told or now_us - max(told) > settings.heading_age * 1e6:
            lack = "heading is old" if told else "no heading source"
            if not self._settings.heading.from_motion:
                return lack
            return self.from_motion(buffer, now_us, buffer_us) or f"{lack}: waiting for motion"
        usable = [(t, f) for t, f in self._fixes if now_us - buffer_us < t <= now_us]
        if not usable:
            return "waiting for a fresh GNSS fix"
        t_us, fix = usable[-1]
        if t_us < buffer.oldest_us:
            return "collecting IMU samples"
        means = mean_rows(buffer.readings(buffer.row_after(now_us - window_us), buffer.end))
        standing = self.standing.standing
        acceleration_l = np.zeros(3) if standing else self._acceleration(now_us - window_us, now_us)
        heading = self._heading_now(now_us, fix, means[3:], acceleration_l)
        if isinstance(heading, str):
            return heading
        return Candidate(
            t_us,
            fix,
            heading,
            means[:3].copy(),
            means[3:].copy(),
            acceleration_l,
            standing,
            yaw_by_mag=None if heading is self._fresh_heading(now_us) else self._yaw_by_mag(fix),
        )

    def _fresh_heading(self, now_us: int) -> HeadingFix | None:
        """The newest heading, if it is of late."""
        seen, age_us = self._heading, self._settings.alignment.heading_age * 1e6
        return seen[1] if seen is not None and now_us - seen[0] <= age_us else None

    def _yaw_by_mag(self, fix: GnssFix) -> FloatArray:
        """What a bias of the field's direction, in l, adds to the yaw that is found from it."""
        m = self._compass.reference_l(fix.lat, fix.lon, fix.alt)
        return np.array([m[1], -m[0], 0.0]) / float(m[0] ** 2 + m[1] ** 2)

    def _heading_now(
        self, now_us: int, fix: GnssFix, accel_b: FloatArray, acceleration_l: FloatArray
    ) -> HeadingFix | str:
        """The newest heading, or where there is none of late the one that the levelled magnetic field shows."""
        s = self._settings
        if (heading := self._fresh_heading(now_us)) is not None:
            return heading
        assert self._field is not None
        t_us, direction_b = self._field
        reference_l = self._compass.reference_l(fix.lat, fix.lon, fix.alt)
        push_l = acceleration_l - np.array([0.0, 0.0, 9.81])
        yaw, dip = levelled(direction_b, accel_b, push_l, reference_l)
        wanted = math.asin(float(reference_l[2]))
        if abs(dip - wanted) > _DIP_LIMIT:
            return (
                f"magnetometer: dip {math.degrees(dip):.0f} deg, "
                f"the Earth's field has {math.degrees(wanted):.0f}"
            )
        tilt = 0.0 if self.standing.standing else math.radians(s.alignment.moving_sigma_deg)
        sigma = math.hypot(s.magnetometer.sigma, tilt * math.sin(wanted)) / math.cos(wanted)
        return HeadingFix(t_us, yaw, min(sigma, math.pi), "magnetometer")

    def _acceleration(self, start_us: int, end_us: int) -> FloatArray:
        """Mean acceleration (3,) in l in m/s^2 over the window as GNSS velocities show it; zero where they do not."""
        fixes = [(t, f) for t, f in self._fixes if f.v_l is not None]
        if len(fixes) < 2:
            return np.zeros(3)
        t0, a = min(fixes, key=lambda item: abs(item[0] - start_us))
        t1, b = min(fixes, key=lambda item: abs(item[0] - end_us))
        if t1 - t0 < 0.3 * (end_us - start_us) or a.v_l is None or b.v_l is None:
            return np.zeros(3)
        dv: FloatArray = np.nan_to_num(np.array(b.v_l) - np.array(a.v_l))
        return dv / ((t1 - t0) * 1e-6)

    def start(
        self,
        candidate: Candidate,
        frame: TangentFrame,
        layout: Layout,
        heading_sigma: Callable[[HeadingFix], float],
    ) -> tuple[FloatArray, FloatArray]:
        """(x, P) of the first state, valid at the candidate's fix."""
        s = self._settings
        fix = candidate.fix
        noise = noise_of(fix, s.gnss)
        C_ln = frame.local_level(fix.lat, fix.lon)
        p_n = frame.from_lla(fix.lat, fix.lon, fix.alt)
        push_l = candidate.acceleration_l - C_ln @ gravity_n(p_n, frame.r0_e, frame.C_ne)
        v_l, R_v = self._velocity(candidate, noise.speed)
        window = s.alignment.window
        tilt = s.imu.accel_noise * 0.1 / (9.8 * math.sqrt(window))
        if not candidate.standing:
            turned = float(np.linalg.norm(candidate.gyro_b)) * window
            tilt = math.hypot(math.radians(s.alignment.moving_sigma_deg), 0.5 * turned)
        b_g = candidate.gyro_b.copy() if candidate.standing else np.zeros(3)
        q_lb = None
        if candidate.attitude is not None:
            q_lb, tilt, b_g = (
                candidate.attitude.q_lb,
                candidate.attitude.sigma_tilt,
                self.motion.b_g.copy(),
            )
        # found in l and then turned into n, so that the heading means the local north
        start = Start(
            accel_b=candidate.accel_b,
            push_n=push_l,
            yaw_n=candidate.heading.yaw,
            p_n=p_n,
            R_p=np.diag([noise.h**2, noise.h**2, noise.v**2]),
            v_n=v_l,
            R_v=R_v,
            b_g=b_g,
            sigma_b_g=s.imu.gyro_bias_sigma,
            sigma_b_a=s.imu.accel_bias_sigma,
            sigma_tilt=tilt,
            sigma_yaw=heading_sigma(candidate.heading),
            lever_b=np.array(s.gnss.lever_arm),
            sigma_lever=s.states.lever_arm_sigma,
            delay=fix.delay,
            sigma_delay=s.states.gnss_delay_sigma,
            sigma_baro=s.states.baro_bias_sigma,
            sigma_mag=s.states.mag_bias_sigma,
            sigma_gravity=math.radians(s.states.gravity_sigma_deg),
            yaw_by_mag=candidate.yaw_by_mag,
            q_nb=q_lb,
        )
        x, P = initial_state(start, layout)
        x[3:6] = C_ln.T @ x[3:6]
        x[6:10] = quat_mul(quat_conj(dcm_to_quat(C_ln)), x[6:10])
        return x, P

    def _velocity(self, candidate: Candidate, sigma: float) -> tuple[FloatArray, FloatArray]:
        """First velocity (3,) in l and its noise; a component that nothing shows is zero to within 3 m/s."""
        if candidate.standing:
            return np.zeros(3), np.eye(3) * self._settings.zero_velocity.sigma**2
        v = np.full(3, math.nan) if candidate.fix.v_l is None else np.array(candidate.fix.v_l)
        sigmas = np.where(np.isnan(v), 3.0, sigma)
        return np.nan_to_num(v), np.diag(sigmas**2)
