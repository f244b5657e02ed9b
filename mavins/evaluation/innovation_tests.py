"""What a sequence of innovations says: whiteness, NIS over a window, biases, the noise behind them, and a delay.

Theory: docs/theory/findings.md.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.ndimage import median_filter

from mavins.estimates import Estimates, Innovations
from mavins.evaluation.consistency import band
from mavins.types import FloatArray, IntArray

_BLOCK_US: Final = 10_000_000
"""Innovations further apart than this are taken for independent."""
_WINDOW_S: Final = 0.14
_LONGEST_S: Final = 1.0
_ROUNDS: Final = 4


def autocorrelation(values: FloatArray, lags: int) -> FloatArray:
    """rho (lags,) of a sequence (N,) at 1, 2, ... steps, about its mean; nan throughout for one that is constant.

    For white values about N(0, 1/N), so that 95 % of them lie within 1.96 / sqrt(N).
    """
    x = values - values.mean() if len(values) else values
    power = float(x @ x)
    if power == 0.0:
        return np.full(lags, np.nan)
    spectrum = np.fft.rfft(
        x, 1 << (len(x) + lags).bit_length()
    )  # padded: what leaves does not come back
    rho: FloatArray = np.fft.irfft(spectrum.real**2 + spectrum.imag**2)[1 : lags + 1] / power
    return rho


def running_mean(values: FloatArray, width: int) -> FloatArray:
    """Means (N - width + 1,) over so many neighbours."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    mean: FloatArray = (total[width:] - total[:-width]) / width
    return mean


def nis_band(rows: int, width: int) -> tuple[float, float]:
    """Where 95 % of the running means of the NIS of measurements with so many rows lie."""
    return band(rows, width)


def bias(innovations: Innovations, component: int) -> tuple[float, float]:
    """The mean of an innovation and its sigma, from means over 10 s; (nan, nan) for less than five of them."""
    r = innovations.innovation[:, component]
    known = np.isfinite(r)
    if not known.any():
        return math.nan, math.nan
    block = innovations.t_us[known] // _BLOCK_US
    _, first = np.unique(block, return_index=True)
    first.sort()
    counts = np.diff(np.append(first, len(block)))
    means = np.add.reduceat(r[known], first) / counts
    if len(means) < 5:
        return math.nan, math.nan
    return float(r[known].mean()), float(means.std(ddof=1) / math.sqrt(len(means)))


def noise_shown(innovations: Innovations, component: int, assumed: float) -> float:
    """The measurement noise that the innovations show: sigma^2 = E[r (z - h(x+))] = E[r^2 R / S].

    `assumed` is the sigma that was taken. A slow error of the sensor does not show. Source: Desroziers et al. (2005).
    """
    r, sigma = innovations.innovation[:, component], innovations.sigma[:, component]
    known = np.isfinite(r) & np.isfinite(sigma) & innovations.accepted
    if not known.any():
        return math.nan
    share = np.minimum(assumed / sigma[known], 1.0) ** 2
    return math.sqrt(float(np.mean(r[known] ** 2 * share)))


def further_delay(
    innovations: Innovations, estimates: Estimates, assumed: FloatArray
) -> tuple[float, float]:
    """By how much GNSS velocities are older than they were taken for, and its sigma, in s; nan without accelerations.

    A velocity that is older by d differs by -d a. The filter follows it with the gain K = 1 - R/S, so its own error
    is d e with e+ = (1 - K) e - K a, and the innovation -d (a + e): one number explains all of them.
    """
    if len(estimates) < 2:
        return math.nan, math.nan
    settled = innovations.t_us > estimates.t_us[0] + _BLOCK_US
    m = innovations.select(innovations.accepted & settled)
    if len(m) < 50:
        return math.nan, math.nan
    delay = spread = 0.0
    for _ in range(_ROUNDS):
        # v(t) - v(t - d) is the acceleration in their middle, times d
        acceleration = _acceleration(estimates, m.t_us - round(0.5e6 * delay))
        delay, spread = _slope(m, acceleration, assumed)
        if not math.isfinite(delay):
            break
        delay = min(max(delay, -_LONGEST_S), _LONGEST_S)
    return delay, spread


def _slope(m: Innovations, acceleration: FloatArray, assumed: FloatArray) -> tuple[float, float]:
    """The delay that explains the innovations best, and its sigma."""
    regressors, values = [], []
    for i in range(min(m.innovation.shape[1], len(assumed))):
        a, sigma = acceleration[:, i], m.sigma[:, i]
        gain = np.clip(1.0 - (assumed[i] / sigma) ** 2, 0.0, 1.0)
        regressors.append(-(a + _followed(a, gain)) / sigma)
        values.append(m.innovation[:, i] / sigma)
    x, y = np.concatenate(regressors), np.concatenate(values)
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    power = float(x @ x)
    if power <= 0.0:
        return math.nan, math.nan
    delay = float(x @ y) / power
    left = y - delay * x
    # neighbours are not independent: two for one
    return delay, math.sqrt(2.0 * float(left @ left) / len(x) / power)


def _acceleration(estimates: Estimates, at_us: IntArray) -> FloatArray:
    """The acceleration (M, 3) at these instants: a median over neighbours, as corrections make the velocity jump."""
    steps = np.diff(estimates.seconds)
    usual = float(np.median(steps))
    if usual > _WINDOW_S / 5.0:
        return np.full((len(at_us), 3), np.nan)
    a = np.diff(estimates.v, axis=0) / np.maximum(steps, 1e-6)[:, None]
    a = median_filter(a, size=(2 * round(0.5 * _WINDOW_S / usual) + 1, 1))
    middle = estimates.seconds[1:] - 0.5 * steps
    return np.column_stack([np.interp(at_us * 1e-6, middle, a[:, i]) for i in range(3)])


def _followed(a: FloatArray, gain: FloatArray) -> FloatArray:
    e = np.zeros(len(a))
    for k in range(len(a) - 1):
        e[k + 1] = (1.0 - gain[k]) * e[k] - gain[k] * a[k]
    return e
