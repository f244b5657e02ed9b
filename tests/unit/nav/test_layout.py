"""Layouts: places of blocks, and boxplus as the inverse of boxminus."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.nav.layout import BLOCKS, CORE, X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import quat_exp, quat_mul

RNG = np.random.default_rng(3)
LAYOUTS = [Layout.of(), Layout.of((*CORE, "l_b")), Layout.of(BLOCKS), Layout.of((*CORE, "tau"))]


def random_state() -> np.ndarray:
    x = RNG.normal(size=X_SIZE)
    x[6:10] = quat_exp(RNG.uniform(-1.5, 1.5, 3))
    return x


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: str(layout.size))
def test_boxplus_undoes_boxminus(layout: Layout) -> None:
    a, d = random_state(), 0.5 * RNG.normal(size=layout.size)
    b = a.copy()
    boxplus(b, d, layout.columns)
    assert_allclose(boxminus(b, a, layout.columns), d, atol=1e-14)


def test_sizes_and_columns() -> None:
    assert [layout.size for layout in LAYOUTS] == [15, 18, 25, 16]
    assert LAYOUTS[3].columns[-1] == 18


def test_the_attitude_error_is_local() -> None:
    x = random_state()
    q, theta = x[6:10].copy(), np.array([0.1, -0.2, 0.3])
    d = np.zeros(15)
    d[6:9] = theta
    boxplus(x, d, LAYOUTS[0].columns)
    expected = quat_mul(q, quat_exp(theta))
    assert_allclose(x[6:10] * np.sign(x[6]), expected * np.sign(expected[0]), atol=1e-15)


def test_blocks_that_a_layout_has_not_are_left_alone() -> None:
    x = random_state()
    before = x.copy()
    boxplus(x, np.ones(15), LAYOUTS[0].columns)
    assert_allclose(x[16:], before[16:], atol=0.0)


@pytest.mark.parametrize(
    "blocks", [("p_n",), (*CORE, "l_b", "l_b"), (*CORE[::-1],), (*CORE, "g_n", "b_m")]
)
def test_a_layout_begins_with_the_core(blocks: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="begins with"):
        Layout.of(blocks)
