"""Readings put in order: what is left out is counted, what stays is unchanged."""

from __future__ import annotations

import numpy as np

from mavins.logs.cleaning import Cleaner, thinned, wild_stamps


def test_rows_are_ordered_and_counted() -> None:
    t_us = np.array([10, 30, 20, 30, 40, 50, 1 << 50, 60, 70])
    usable = np.array([1, 1, 1, 1, 1, 0, 1, 1, 1], dtype=bool)
    clean = Cleaner()
    assert t_us[clean.rows("imu", t_us, usable)].tolist() == [10, 20, 30, 40, 60, 70]
    assert clean.dropped == {"imu unusable": 1, "imu wild stamp": 1, "imu repeated": 1}
    assert clean.disorder == {"imu_backwards": 1}


def test_a_gap_is_not_wild() -> None:
    t_us = np.concatenate([np.arange(10), 1_000_000_000 + np.arange(10)])
    assert not wild_stamps(t_us).any()
    t_us[[3, 15]] = [1 << 40, 0]
    assert np.flatnonzero(wild_stamps(t_us)).tolist() == [3, 15]
    assert not wild_stamps(t_us[:4]).any()


def test_thinning_keeps_means() -> None:
    t_us = np.arange(0, 1_000_000, 10_000) + 3
    values = np.column_stack([t_us * 2.0, np.ones(len(t_us))])
    fewer, means = thinned(t_us, values)
    assert len(fewer) == 20
    np.testing.assert_allclose(means[:, 0], 2.0 * fewer, atol=2.0)
    np.testing.assert_array_equal(means[:, 1], 1.0)
    assert fewer.dtype == np.int64


def test_what_is_slow_is_left_as_it_is() -> None:
    t_us = np.arange(0, 1_000_000, 100_000)
    values = np.arange(10.0)[:, None]
    assert thinned(t_us, values)[1] is values
    assert len(thinned(t_us[:1], values[:1])[0]) == 1
