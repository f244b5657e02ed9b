"""The gate's threshold in sigmas means the same for any number of rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from mavins.estimator.gate import gate_threshold


@pytest.mark.parametrize("sigmas", [1.0, 3.0, 5.0])
@pytest.mark.parametrize("rows", [1, 2, 3, 6])
def test_as_rare_as_so_many_sigmas(sigmas: float, rows: int) -> None:
    expected = chi2.isf(2.0 * norm.sf(sigmas), rows)
    assert gate_threshold(sigmas, rows) == pytest.approx(expected, rel=1e-8)


def test_one_row_is_the_square() -> None:
    assert gate_threshold(5.0, 1) == pytest.approx(25.0)


@pytest.mark.parametrize("rows", [1, 3])
def test_it_rises_with_the_sigmas_without_end(rows: int) -> None:
    values = [gate_threshold(s, rows) for s in (1.0, 5.0, 7.99, 8.01, 20.0, 100.0)]
    assert np.all(np.diff(values) > 0.0)
    assert values[-1] > 9_000.0
