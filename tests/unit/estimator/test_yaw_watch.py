"""When the filter's yaw is put in doubt."""

from __future__ import annotations

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity
from mavins.aiding.gnss_velocity import model
from mavins.estimator.fusion import Event
from mavins.estimator.yaw_watch import YawWatch


def velocity(nis: float, quality: str = "", aiding: str = gnss_velocity.NAME) -> Event:
    z, R = np.zeros(2), np.eye(2)
    m = Measurement(aiding, 1, "gnss", 0, 0, z, R, np.empty(0), model, 5.0, quality)
    return Event(m, (0, 1, "gnss", 0), nis=nis)


def test_many_surprises_raise_doubt_and_one_does_not() -> None:
    watch = YawWatch()
    watch.see(velocity(1e6))
    assert not watch.doubts
    for _ in range(3):
        watch.see(velocity(12.0))
    assert watch.doubts
    watch.calm()
    assert not watch.doubts


def test_what_is_expected_takes_doubt_away() -> None:
    watch = YawWatch()
    for _ in range(1000):
        watch.see(velocity(1e6))
    assert watch.doubts
    for _ in range(5):
        watch.see(velocity(2.0))
    assert not watch.doubts


def test_only_velocities_that_could_be_used_count() -> None:
    watch = YawWatch()
    for _ in range(100):
        watch.see(velocity(100.0, quality="few satellites"))
        watch.see(velocity(float("nan")))
        watch.see(velocity(100.0, aiding=gnss_position.NAME))
    assert not watch.doubts
