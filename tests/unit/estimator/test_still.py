"""Standing in between: where the detectors find it in the service."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mavins.estimator.aiding_settings import ZeroVelocitySettings
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.standing import StandingDetector
from mavins.estimator.still import EVERY_US, StillDetector, still_detector
from mavins.nav.earth import TangentFrame
from mavins.types import Origin

FRAME = TangentFrame.at(Origin(math.radians(47.0), math.radians(8.0), 400.0))
STEP_US = 5_000
TICK_US = 200_000


def gait(seconds: float = 6.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half a second of swing, half a second of stance, again and again: stamps, rows, whether it stands."""
    rng = np.random.default_rng(1)
    t_us = np.arange(0, round(seconds * 1e6), STEP_US) + 1_000_000
    swing = (t_us - 1_000_000) % 1_000_000 < 500_000
    imu = rng.normal(0.0, 1e-3, (len(t_us), 6))
    imu[:, 5] -= 9.81
    # to and fro within a window: a constant acceleration is nothing to AMVD
    sign = np.where(t_us[swing] // 20_000 % 2, 1.0, -1.0)
    imu[swing, 1] += 4.0 * sign
    imu[swing, 3] += 8.0 * sign
    return t_us, imu, ~swing


def found(settings: ZeroVelocitySettings, speed: float = 0.0, at_once: int = 1) -> np.ndarray:
    detector, seen = StillDetector(settings), StandingDetector(settings)
    buffer = ImuBuffer()
    t_us, imu, _ = gait()
    instants = []
    for k in range(0, len(t_us), at_once):
        buffer.append(t_us[k : k + at_once], imu[k : k + at_once])
        now_us = buffer.newest_us
        seen.see_speed(speed, now_us)
        if now_us % TICK_US == 0:
            instants += [still.t_us for still in detector.tick(buffer, now_us, FRAME, seen)]
    return np.array(instants)


@pytest.mark.parametrize("kind", ["shoe", "ared", "amvd"])
@pytest.mark.parametrize("threshold", ["auto", 1e4])
def test_stances_are_found_and_swings_are_not(kind: str, threshold: object) -> None:
    settings = dataclasses.replace(ZeroVelocitySettings(), detector=kind, threshold=threshold)
    instants = found(settings)
    t_us, _, standing = gait()
    assert standing[np.searchsorted(t_us, instants)].all()
    stances = (instants[instants > 2_000_000] - 1_000_000) // 1_000_000
    assert set(stances.tolist()) == {1, 2, 3, 4, 5}
    assert np.diff(instants).min() >= EVERY_US
    # six windows fit into a stance of half a second
    assert np.bincount(stances)[1:5].min() >= 4


def test_a_moving_vehicle_never_stands() -> None:
    settings = dataclasses.replace(ZeroVelocitySettings(), detector="shoe")
    assert len(found(settings, speed=2.0)) == 0


def test_gnss_speed_alone_and_only_while_it_is_fresh() -> None:
    settings = dataclasses.replace(ZeroVelocitySettings(), detector="gnss_speed")
    assert len(found(settings)) > 80
    assert len(found(settings, speed=1.0)) == 0
    detector, seen, buffer = StillDetector(settings), StandingDetector(settings), ImuBuffer()
    t_us, imu, _ = gait()
    buffer.append(t_us, imu)
    assert detector.tick(buffer, buffer.newest_us, FRAME, seen) == []
    seen.see_speed(0.0, buffer.newest_us - 2_000_000)
    assert detector.tick(buffer, buffer.newest_us, FRAME, seen) == []


def test_start_is_the_aligners() -> None:
    assert still_detector(ZeroVelocitySettings()) is None
