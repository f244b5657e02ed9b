"""The chi-square gate: a bound on the NIS of m rows that means the same as so many sigmas of one row."""

from __future__ import annotations

from functools import cache

from scipy.special import chdtri, erfc


@cache
def gate_threshold(sigmas: float, rows: int) -> float:
    """The NIS that `rows` Gaussian rows exceed as rarely as one row exceeds `sigmas` standard deviations.

    P(chi2_rows > threshold) = P(|N(0, 1)| > sigmas) = erfc(sigmas / sqrt(2)); for one row it is sigmas^2.
    Beyond 8 sigmas, where probabilities run out of digits, the threshold grows with the square of the sigmas.
    """
    base = min(sigmas, 8.0)
    threshold = float(chdtri(rows, float(erfc(base / 2.0**0.5))))
    return threshold * (sigmas / base) ** 2
