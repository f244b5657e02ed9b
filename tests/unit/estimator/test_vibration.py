"""Vibration: what shakes counts, what moves does not, however the rows come."""

from __future__ import annotations

import numpy as np
import pytest

from mavins.estimator.vibration import CLIP, Vibration
from mavins.types import FloatArray, IntArray


class Rows:
    """IMU rows as an estimator gives them, up to a moment that a test moves on."""

    def __init__(self, seconds: float, rate: float = 250.0, start_us: int = 1_000_000) -> None:
        n = round(seconds * rate)
        self.times = start_us + (np.arange(n) * 1e6 / rate).astype(np.int64)
        self.imu = np.zeros((n, 6))
        self.imu[:, 5] = -9.8
        self.end = n

    @property
    def t_us(self) -> int | None:
        return int(self.times[self.end - 1]) if self.end else None

    def imu_after(self, t_us: int) -> tuple[IntArray, FloatArray]:
        first = int(np.searchsorted(self.times, t_us, "right"))
        return self.times[first : self.end], self.imu[first : self.end]

    def sine(self, axis: int, hz: float, amplitude: float) -> None:
        self.imu[:, 3 + axis] += amplitude * np.sin(2e-6 * np.pi * hz * self.times)


def test_a_shaking_axis_shows_its_standard_deviation() -> None:
    rows, shaking = Rows(4.0), Vibration()
    rows.sine(0, 60.0, 4.0)
    rows.sine(1, 0.3, 4.0)
    shaking.look(rows)
    x, y, z = shaking.level
    assert x == pytest.approx(4.0 / np.sqrt(2.0), rel=0.12)
    assert y < 0.3, "a slow push is motion"
    assert z < 1e-9
    assert shaking.clipped == 0


def test_samples_at_the_limit_are_counted() -> None:
    rows, shaking = Rows(1.0), Vibration()
    rows.imu[10:14, 3] = CLIP
    rows.imu[12:16, 4] = -CLIP - 5.0
    shaking.look(rows)
    assert shaking.clipped == 6


def test_the_outcome_does_not_depend_on_when_it_is_looked_at() -> None:
    rows = Rows(2.0)
    rows.imu[:, 3:] += np.random.default_rng(1).normal(size=(500, 3)) * 80.0
    whole, often = Vibration(), Vibration()
    whole.look(rows)
    for end in (0, 1, 2, 7, 7, 100, 499, 500):
        rows.end = end
        often.look(rows)
    assert often.level == whole.level
    assert often.clipped == whole.clipped > 0


def test_a_reboot_starts_anew() -> None:
    rows, shaking = Rows(2.0, start_us=100_000_000), Vibration()
    rows.sine(0, 60.0, 9.0)
    shaking.look(rows)
    assert shaking.level[0] > 5.0
    again = Rows(0.004)
    shaking.look(again)
    assert shaking.level == (0.0, 0.0, 0.0)
