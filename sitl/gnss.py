"""The GNSS receiver: its antenna's position and velocity, late, noisy, and at times not at all.

The message stamped t carries the fix valid at t - latency:

    p = p_n + C_nb l + n_p + m_p,    v = v_n + C_nb (w_nb_b x l) + n_v + m_v

with white n and first-order Gauss-Markov m. Velocities are relative to the Earth, as n is: the rate
for the lever is w_nb_b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from mavins.nav.earth import TangentFrame
from mavins.nav.rotations import quats_to_dcms
from mavins.types import FloatArray, GnssFix, IntArray
from sitl.settings import NonNegative, Positive, Rate, Settings
from sitl.trajectory import Kinematics

NO_FIX = 1
SATELLITES_LEFT = 3


@dataclass(frozen=True, slots=True)
class MarkovSettings(Settings):
    """A first-order Gauss-Markov error per axis: `sigma` (m or m/s) and correlation `time` in s."""

    sigma: NonNegative = 0.0
    time: Positive = 60.0


@dataclass(frozen=True, slots=True)
class ReportedSettings(Settings):
    """The accuracies that the receiver claims, in m and m/s; null claims the true ones."""

    sigma_h: NonNegative | None = None
    sigma_v: NonNegative | None = None
    sigma_speed: NonNegative | None = None


@dataclass(frozen=True, slots=True)
class GnssSettings(Settings):
    """The receiver: white sigmas per axis in m and m/s, `latency` in s, `lever_arm` l_b in m.

    `outages` are windows [from, to) in s from the start of each cycle.
    """

    rate: Rate = 5
    sigma_h: NonNegative = 0.5
    sigma_v: NonNegative = 0.8
    sigma_speed: NonNegative = 0.1
    markov_position: MarkovSettings = field(default_factory=MarkovSettings)
    markov_velocity: MarkovSettings = field(default_factory=MarkovSettings)
    latency: NonNegative = 0.0
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    outages: tuple[tuple[float, float], ...] = ()
    fix_type: Annotated[int, Ge(2), Le(6)] = 3
    satellites: Annotated[int, Ge(0), Le(254)] = 14
    reported: ReportedSettings = field(default_factory=ReportedSettings)


class Markov:
    """m_k = phi m_(k-1) + sigma sqrt(1 - phi^2) w, phi = exp(-1 / (rate time)).

    m_0 is drawn from the steady state, so its sigma is the same at all times.
    """

    def __init__(self, settings: MarkovSettings, rate: int, rng: np.random.Generator) -> None:
        self._phi = math.exp(-1.0 / (rate * settings.time))
        self._drive = settings.sigma * math.sqrt(1.0 - self._phi**2)
        self._m = settings.sigma * rng.standard_normal(3)

    def next(self, n: int, rng: np.random.Generator) -> FloatArray:
        """The errors (n, 3) of the next n samples."""
        errors = np.empty((n, 3))
        for k, w in enumerate(rng.standard_normal((n, 3))):
            self._m = self._phi * self._m + self._drive * w
            errors[k] = self._m
        return errors


class Receiver:
    """The receiver and its slowly wandering errors."""

    def __init__(
        self, settings: GnssSettings, frame: TangentFrame, period: float, rng: np.random.Generator
    ) -> None:
        self._settings = settings
        self._frame = frame
        self._period = period
        self._position_error = Markov(settings.markov_position, settings.rate, rng)
        self._velocity_error = Markov(settings.markov_velocity, settings.rate, rng)
        s, reported = settings, settings.reported
        self._claims = (
            _claim(reported.sigma_h, s.sigma_h, s.markov_position),
            _claim(reported.sigma_v, s.sigma_v, s.markov_position),
            _claim(reported.sigma_speed, s.sigma_speed, s.markov_velocity),
        )
        self._last: GnssFix | None = None

    def measure(
        self, t_us: IntArray, k: Kinematics, rng: np.random.Generator
    ) -> tuple[GnssFix, ...]:
        """The fixes stamped t_us (N,), of the motion at their valid times k.t = t - latency."""
        s = self._settings
        n = len(t_us)
        sigma_p = np.array([s.sigma_h, s.sigma_h, s.sigma_v])
        C_nb = quats_to_dcms(k.q_nb)
        lever = np.array(s.lever_arm)
        p_n = k.p_n + C_nb @ lever
        v_n = k.v_n + np.einsum("nij,nj->ni", C_nb, np.cross(k.w_nb_b, lever))
        p_n += sigma_p * rng.standard_normal((n, 3)) + self._position_error.next(n, rng)
        v_n += s.sigma_speed * rng.standard_normal((n, 3)) + self._velocity_error.next(n, rng)
        return tuple(
            self._fix(int(t_us[i]), float(k.t[i]), p_n[i].copy(), v_n[i]) for i in range(n)
        )

    def _fix(self, t_us: int, t_valid: float, p_n: FloatArray, v_n: FloatArray) -> GnssFix:
        phase = t_valid % self._period
        frozen = self._last
        if frozen is not None and any(a <= phase < b for a, b in self._settings.outages):
            return GnssFix(
                t_us, frozen.lat, frozen.lon, frozen.alt, frozen.v_l, NO_FIX, SATELLITES_LEFT
            )
        lat, lon, alt = (float(x) for x in self._frame.to_lla(p_n))
        north, east, down = (float(x) for x in self._frame.local_level(lat, lon) @ v_n)
        s = self._settings
        v_l = (north, east, down)
        self._last = GnssFix(t_us, lat, lon, alt, v_l, s.fix_type, s.satellites, *self._claims)
        return self._last


def _claim(reported: float | None, white: float, markov: MarkovSettings) -> float:
    return math.hypot(white, markov.sigma) if reported is None else reported
