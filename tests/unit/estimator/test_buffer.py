"""The table of IMU rows: numbering, late rows, and what is dropped, against a plain list."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.estimator.buffer import ImuBuffer


def filled(n: int, capacity: int = 8) -> ImuBuffer:
    buffer = ImuBuffer(capacity)
    t = 1000 * np.arange(1, n + 1)
    buffer.append(t, t[:, None] * np.ones(6))
    return buffer


def test_rows_come_back_as_they_went_in() -> None:
    buffer = filled(20)
    assert len(buffer) == 20
    assert (buffer.first, buffer.end) == (0, 20)
    assert (buffer.oldest_us, buffer.newest_us) == (1000, 20_000)
    assert buffer.times(3, 6).tolist() == [4000, 5000, 6000]
    assert_array_equal(buffer.readings(3, 5)[:, 0], [4000.0, 5000.0])


@pytest.mark.parametrize(("t_us", "row"), [(0, 0), (999, 0), (1000, 1), (1001, 1), (9_000, 9)])
def test_the_row_after_an_instant(t_us: int, row: int) -> None:
    assert filled(9).row_after(t_us) == row


def test_a_late_row_moves_the_later_ones_up() -> None:
    buffer = filled(8)
    assert buffer.insert(3500, np.full(6, -1.0)) == 3
    assert buffer.times(2, 5).tolist() == [3000, 3500, 4000]
    assert_array_equal(buffer.readings(2, 5)[:, 5], [3000.0, -1.0, 4000.0])
    assert (buffer.end, buffer.newest_us) == (9, 8000)
    assert buffer.contains(3500)
    assert not buffer.contains(3501)


def test_the_reading_between_rows_lies_on_their_line() -> None:
    buffer = filled(5)
    assert_allclose(buffer.reading_at(2250), np.full(6, 2250.0))
    assert_array_equal(buffer.reading_at(3000), np.full(6, 3000.0))
    reading = buffer.reading_at(1000)
    reading[:] = 0.0
    assert_array_equal(buffer.readings(0, 1)[0], np.full(6, 1000.0))


def test_numbers_stay_when_old_rows_go() -> None:
    buffer = filled(16, capacity=16)
    buffer.drop_before(12_500)
    assert buffer.first == 11
    assert buffer.oldest_us == 12_000
    assert buffer.times(12, 14).tolist() == [13_000, 14_000]
    assert buffer.row_after(13_000) == 13
    buffer.append(np.array([17_000]), np.zeros((1, 6)))
    assert buffer.end == 17


def test_little_is_not_worth_moving() -> None:
    buffer = filled(16, capacity=16)
    buffer.drop_before(4_500)
    assert buffer.first == 0
    assert len(buffer) == 16


def test_against_a_plain_list() -> None:
    rng = np.random.default_rng(6)
    buffer, rows, dropped = ImuBuffer(4), {}, 0
    now = 0
    for _ in range(2000):
        if rng.uniform() < 0.8 or len(rows) < 20:
            now += int(rng.integers(1, 2000))
            t_us = now
            buffer.append(np.array([t_us]), np.full((1, 6), float(t_us)))
        else:
            t_us = now - int(rng.integers(1, 10_000))
            if buffer.contains(t_us) or t_us < buffer.oldest_us:
                continue
            buffer.insert(t_us, np.full(6, float(t_us)))
        rows[t_us] = float(t_us)
        buffer.drop_before(now - 30_000)
        dropped = buffer.first
        expected = sorted(rows)[dropped:]
        assert buffer.times(buffer.first, buffer.end).tolist() == expected
    assert dropped > 1000
    assert_array_equal(buffer.readings(buffer.first, buffer.end)[:, 2], np.array(expected, float))


def test_clearing_goes_on_counting() -> None:
    buffer = filled(5)
    buffer.clear()
    assert len(buffer) == 0
    assert buffer.first == buffer.end == 5
