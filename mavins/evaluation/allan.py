"""The noises of an IMU that stands still, from the overlapping Allan deviation of each axis.

    avar(tau) = sum (theta_(i+2m) - 2 theta_(i+m) + theta_i)^2 / (2 tau^2 (N - 2m)),   tau = m dt
    avar(tau) ~ N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3

N is the white noise's density, read at slope -1/2 and tau = 1 s, B the bias instability, K the random walk's density,
read at slope +1/2 and tau = 3 s. Sources: IEEE Std 952-1997, annex C; Riley, NIST SP 1065 (2008), sections 5.2.4 and
5.4.1 for the degrees of freedom. Theory: docs/theory/allan.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls

from mavins.errors import LogFormatError
from mavins.types import FloatArray, ImuTable, IntArray

GYRO_LIMIT: Final = 0.03
ACCEL_LIMIT: Final = 0.12
"""A sensor stands while its mean over each second stays this near (rad/s, m/s^2) to that of the spell's first."""
SHORTEST_S: Final = 30.0
SHORTEST_TAU: Final = 0.1
"""Below it, a sensor's own low-pass filter and its resolution are seen rather than its noise."""
LONGEST_SHARE: Final = 1 / 6
"""The longest tau as a share of the record: beyond it, the deviation hangs on a handful of differences."""
MODEL_ERROR: Final = 0.05
"""How far, as a share, a real sensor's variance may lie off the model: it keeps short tau from deciding alone."""
SIGMAS_95: Final = 1.96
UNITS: Final = {
    "gyro": ("rad/s/sqrt(Hz)", "rad/s", "rad/s^2/sqrt(Hz)"),
    "accel": ("m/s^2/sqrt(Hz)", "m/s^2", "m/s^3/sqrt(Hz)"),
}
"""Units of N, B and K."""


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One of N, B, K with its 95 % interval; `seen` where it makes up most of the variance at some tau."""

    value: float
    low: float
    high: float
    seen: bool


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis: its deviation `adev` (T,) at `tau` (T,) s, the fitted one, and the coefficients."""

    name: str
    tau: FloatArray
    adev: FloatArray
    fitted: FloatArray
    white: Coefficient
    instability: Coefficient
    walk: Coefficient


@dataclass(frozen=True, slots=True)
class Allan:
    """A standing spell from `start_s` on for `seconds` of `log_s`, sampled every `dt` s, and its six axes."""

    axes: tuple[Axis, ...]
    start_s: float
    seconds: float
    log_s: float
    dt: float

    def of(self, sensor: str) -> tuple[Axis, ...]:
        """The three axes of "gyro" or "accel"."""
        return tuple(axis for axis in self.axes if axis.name.startswith(sensor))

    def settings(self) -> dict[str, float]:
        """What of it is a setting, as the root mean square over three axes; only what is seen on all of them."""
        values = {}
        for sensor in UNITS:
            axes = self.of(sensor)
            for name, of_axis in (
                ("noise", [axis.white for axis in axes]),
                ("bias_walk", [axis.walk for axis in axes]),
            ):
                if all(c.seen for c in of_axis):
                    mean = math.sqrt(sum(c.value**2 for c in of_axis) / len(of_axis))
                    values[f"imu.{sensor}_{name}"] = float(f"{mean:.3g}")
        return values


def overlapping_variance(y: FloatArray, dt: float, m: int) -> float:
    """The overlapping Allan variance of rates y (N,) every dt s, at tau = m dt."""
    theta = np.concatenate([[0.0], np.cumsum(y - y.mean())]) * dt
    second = theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]
    return float(second @ second) / (2.0 * (m * dt) ** 2 * len(second))


def degrees_of_freedom(n: int, m: int) -> FloatArray:
    """Of the variance at tau = m dt from n values of theta: for white noise, instability and random walk (3,)."""
    white = (1.5 * (n - 1) / m - 2.0 * (n - 2) / n) * 4.0 * m * m / (4.0 * m * m + 5.0)
    flicker = 2.0 * (n - 2) / (2.3 * n - 4.9) if m == 1 else 5.0 * n * n / (4.0 * m * (n + 3.0 * m))
    walk = (n - 2) / m * ((n - 1) ** 2 - 3.0 * m * (n - 1) + 4.0 * m * m) / (n - 3) ** 2
    return np.fmax(1.0, np.array([white, flicker, walk], dtype=np.float64))


def analyse(name: str, y: FloatArray, dt: float) -> Axis:
    """The deviation of one axis y (N,) and its coefficients, by least squares with what each tau is worth."""
    n = len(y) + 1
    first, last = max(1, round(SHORTEST_TAU / dt)), int(LONGEST_SHARE * len(y))
    factors = np.unique(
        np.geomspace(first, last, 1 + round(2 * math.log2(last / first))).astype(int)
    )
    avar = np.array([overlapping_variance(y, dt, m) for m in factors.tolist()])
    edf = np.array([degrees_of_freedom(n, m) for m in factors.tolist()])
    tau = factors * dt
    A = np.column_stack([1.0 / tau, np.ones(len(tau)), tau])
    model, x = np.maximum(avar, 1e-300), np.zeros(3)
    for _ in range(5):
        shares = A * x / model[:, None]
        freedom = 1.0 / (shares / edf).sum(axis=1) if x.any() else edf.min(axis=1)
        weight = 1.0 / (model * np.sqrt(2.0 / freedom + MODEL_ERROR**2))
        x, _ = nnls(A * weight[:, None], avar * weight)
        model = np.maximum(A @ x, 1e-300)
    # half octaves are not independent: neighbours share about half of what they know
    covariance = 2.0 * np.linalg.inv((A * weight[:, None]).T @ (A * weight[:, None]))
    shares = A * x / model[:, None]
    scales = (1.0, 0.5 * math.pi / math.log(2.0), 3.0)
    white, instability, walk = (
        _coefficient(x[i] * s, math.sqrt(covariance[i, i]) * s, float(shares[:, i].max()))
        for i, s in enumerate(scales)
    )
    return Axis(name, tau, np.sqrt(avar), np.sqrt(model), white, instability, walk)


def _coefficient(square: float, sigma: float, share: float) -> Coefficient:
    """From its square with a 1-sigma; the interval is a factor, as that of a chi-square variance is."""
    value, margin = math.sqrt(square), SIGMAS_95 * sigma
    if share <= 0.5 or square <= margin:
        return Coefficient(value, 0.0, math.sqrt(square + margin), False)
    factor = math.exp(0.5 * margin / square)
    return Coefficient(value, value / factor, value * factor, True)


def standing_spell(imu: ImuTable) -> slice:
    """The longest run of samples without a gap in which the sensor stands."""
    t_us = imu.t_us
    gap_us = max(100_000, 10 * int(np.median(np.diff(t_us))))
    edges = [0, *(np.flatnonzero(np.diff(t_us) > gap_us) + 1).tolist(), len(t_us)]
    best = slice(0, 0)
    for first, end in itertools.pairwise(edges):
        for spell in _spells(imu, first, end):
            if spell.stop - spell.start > best.stop - best.start:
                best = spell
    return best


def _spells(imu: ImuTable, first: int, end: int) -> Sequence[slice]:
    """The standing spells, in whole seconds, among samples without a gap."""
    t_us: IntArray = imu.t_us[first:end]
    starts = first + np.unique(np.searchsorted(t_us, np.arange(t_us[0], t_us[-1], 1_000_000)))
    count = np.diff([*starts, end])[:, None]
    readings = np.hstack([imu.gyro_b[first:end], imu.accel_b[first:end]])
    means = np.add.reduceat(readings, starts - first) / count
    limits = np.repeat([GYRO_LIMIT, ACCEL_LIMIT], 3)
    spells, begin = [], 0
    for k in range(1, len(means) + 1):
        if k == len(means) or (np.abs(means[k] - means[begin]) > limits).any():
            spells.append(slice(int(starts[begin]), end if k == len(means) else int(starts[k])))
            begin = k
    return spells


def allan(imu: ImuTable) -> Allan:
    """All six axes over the longest standing spell; LogFormatError where there is none worth the name."""
    log_s = float(imu.t_us[-1] - imu.t_us[0]) * 1e-6
    spell = standing_spell(imu)
    t_us = imu.t_us[spell]
    seconds = float(t_us[-1] - t_us[0]) * 1e-6 if len(t_us) else 0.0
    if seconds < SHORTEST_S:
        raise LogFormatError(
            f"the IMU stands still for {seconds:.0f} s at most in this log; "
            f"record at least {SHORTEST_S:.0f} s, and hours for a random walk"
        )
    dt = seconds / (len(t_us) - 1)
    named = [
        (f"{sensor} {axis}", table[spell, k])
        for sensor, table in (("gyro", imu.gyro_b), ("accel", imu.accel_b))
        for k, axis in enumerate("xyz")
    ]
    start_s = float(t_us[0] - imu.t_us[0]) * 1e-6
    return Allan(tuple(analyse(*one, dt) for one in named), start_s, seconds, log_s, dt)
