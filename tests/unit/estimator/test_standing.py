"""Standing is found before the first motion, and not again after it."""

from __future__ import annotations

import numpy as np

from mavins.estimator.aiding_settings import ZeroVelocitySettings
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.standing import StandingDetector, mean_rows

REST = np.array([0.002, -0.001, 0.003, 0.1, -0.2, -9.8])
TICK_US = 200_000


class Watch:
    """A detector that sees an IMU at 100 Hz with white noise."""

    def __init__(self) -> None:
        self.detector = StandingDetector(ZeroVelocitySettings())
        self.buffer = ImuBuffer()
        self.rng = np.random.default_rng(1)
        self.now_us = 0

    def see(self, seconds: float, reading: np.ndarray = REST) -> None:
        for _ in range(round(seconds * 100)):
            self.now_us += 10_000
            noise = self.rng.normal(size=(1, 6)) * np.repeat([0.01, 0.1], 3)
            self.buffer.append(np.array([self.now_us]), reading + noise)
            if self.now_us % TICK_US == 0:
                self.detector.tick(self.buffer, self.now_us)


def test_a_quiet_vehicle_is_found_standing() -> None:
    w = Watch()
    w.see(0.4)
    assert not w.detector.standing
    w.see(1.2)
    assert w.detector.quiet
    assert w.detector.standing
    w.see(20.0)
    assert w.detector.standing


def test_a_push_ends_it_for_good() -> None:
    w = Watch()
    w.see(2.0)
    w.see(0.5, REST + np.array([0, 0, 0, 0.0, 0.0, -1.0]))
    assert w.detector.moved
    w.see(10.0)
    assert w.detector.quiet
    assert not w.detector.standing


def test_a_turn_ends_it_for_good() -> None:
    w = Watch()
    w.see(2.0)
    w.see(0.5, REST + np.array([0, 0, 0.1, 0, 0, 0]))
    assert w.detector.moved
    assert not w.detector.standing


def test_a_steady_turn_is_not_standing() -> None:
    w = Watch()
    w.see(5.0, REST + np.array([0, 0, 0.2, 0, 0, 0]))
    assert not w.detector.standing


def test_a_drift_of_the_readings_is_not_overlooked() -> None:
    w = Watch()
    for k in range(100):
        w.see(0.1, REST + np.array([0, 0, 0, 0.02 * k, 0, 0]))
    assert not w.detector.standing


def test_speed_from_gnss_ends_it() -> None:
    w = Watch()
    w.see(2.0)
    w.detector.see_speed(0.3, 0)
    assert w.detector.standing
    w.detector.see_speed(2.0, 0)
    assert w.detector.moved
    w.detector.see_speed(0.0, 0)
    assert not w.detector.standing


def test_a_moving_vehicle_that_was_never_quiet_has_not_moved_yet() -> None:
    """Speeds before the first quiet second may be the receiver's own start."""
    w = Watch()
    w.detector.see_speed(2.0, 0)
    w.see(2.0)
    w.detector.see_speed(0.1, 0)
    assert w.detector.standing


def test_a_hole_in_the_samples_is_no_standing() -> None:
    w = Watch()
    w.see(2.0)
    w.now_us += 1_000_000
    w.see(0.01)
    w.detector.tick(w.buffer, w.now_us)
    assert not w.detector.quiet


def test_means_are_sums_in_order() -> None:
    rows = np.random.default_rng(2).normal(size=(37, 6))
    np.testing.assert_allclose(mean_rows(rows), rows.mean(axis=0), atol=1e-15)
