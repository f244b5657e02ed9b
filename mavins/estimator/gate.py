"""The chi-square gate: a bound on the NIS of m rows that means the same as so many sigmas of one row."""

from __future__ import annotations

import math
from functools import cache


def chi2_survival(x: float, rows: int) -> float:
    """P(chi2_rows > x).

    Q_m(x) = Q_{m-2}(x) + (x/2)^(m/2-1) e^(-x/2) / Gamma(m/2), from Q_1 = erfc(sqrt(x/2)) or Q_0 = 0.
    Written out because the service would otherwise spend a quarter of its start importing a library for it.
    Source: Abramowitz and Stegun, 26.4.4 and 26.4.5.
    """
    m = 1 if rows % 2 else 0
    total = math.erfc(math.sqrt(0.5 * x)) if m else 0.0
    while m < rows:
        m += 2
        total += math.exp((0.5 * m - 1.0) * math.log(0.5 * x) - 0.5 * x - math.lgamma(0.5 * m))
    return total


@cache
def gate_threshold(sigmas: float, rows: int) -> float:
    """The NIS that `rows` Gaussian rows exceed as rarely as one row exceeds `sigmas` standard deviations.

    P(chi2_rows > threshold) = P(|N(0, 1)| > sigmas) = erfc(sigmas / sqrt(2)); for one row it is sigmas^2.
    Beyond 8 sigmas, where probabilities run out of digits, the threshold grows with the square of the sigmas.
    """
    base = min(sigmas, 8.0)
    wanted = math.erfc(base / math.sqrt(2.0))
    low, high = 0.0, 4.0 * (base + math.sqrt(rows)) ** 2 + 10.0
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        if chi2_survival(middle, rows) > wanted:
            low = middle
        else:
            high = middle
    return high * (sigmas / base) ** 2
