"""Is a covariance honest? The normalized estimation error squared (NEES) and its mean's band.

    NEES = e^T P^-1 e,   e = x_true [-] x

is chi-square distributed with as many degrees of freedom as e has components, so the sum over
independent runs is too, with all of them: the mean over M runs of an n-dimensional error lies
within chi2_(M n) / M.
Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation"
(2001), section 5.4. Theory: docs/theory/consistency.md.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from mavins.nav.layout import CORE, Layout, boxminus
from mavins.types import FloatArray, IntArray

NAVIGATION: IntArray = np.arange(9)
"""The errors that are judged unless others are named: p_n, v_n and theta_b."""


def errors(x_true: FloatArray, x: FloatArray) -> FloatArray:
    """E (N, 15) = x_true [-] x for nominal states (N, 26), over the core errors of `layout`."""
    columns = Layout.of(CORE).columns
    e = np.empty((len(x), len(columns)))
    for k in range(len(x)):
        e[k] = boxminus(x_true[k], x[k], columns)
    return e


def nees(e: FloatArray, P: FloatArray, which: IntArray = NAVIGATION) -> FloatArray:
    """E^T P^-1 e (N,) of errors e (N, n), covariances P (N, n, n), over the components `which`."""
    part = e[:, which]
    block = P[:, which[:, None], which]
    solved = np.asarray(np.linalg.solve(block, part[..., None])[..., 0], dtype=np.float64)
    return np.asarray(np.einsum("ki,ki->k", part, solved), dtype=np.float64)


def band(dof: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """The two-sided band of the mean NEES over `runs` runs: chi2_(dof runs) / runs."""
    tail = 0.5 * (1.0 - confidence)
    total = dof * runs
    return float(chdtri(total, 1.0 - tail)) / runs, float(chdtri(total, tail)) / runs


def share_inside(mean: FloatArray, dof: int, runs: int, confidence: float = 0.95) -> float:
    """The share of instants at which the mean NEES (N,) keeps its band."""
    low, high = band(dof, runs, confidence)
    return float(np.mean((mean >= low) & (mean <= high)))
