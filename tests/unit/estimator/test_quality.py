"""Which fixes are trusted, with which noise, and when the first is used."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from mavins.estimator.quality import StartGate, noise_of, objection
from mavins.estimator.settings import GnssSettings
from mavins.types import GnssFix

SETTINGS = GnssSettings()
GOOD = GnssFix(0, 0.8, 0.15, 500.0, (0.0, 0.0, 0.0), 3, 12, 1.0, 1.5, 0.4)
METRE = 1.0 / 6.378e6


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""),
        ({"fix_type": 2}, "no 3D fix"),
        ({"fix_type": 0}, "no 3D fix"),
        ({"lat": 0.0, "lon": 0.0}, "null position"),
        ({"lat": 0.0}, ""),
        ({"satellites": 5}, "few satellites"),
        ({"satellites": None}, ""),
        ({"sigma_h": 5.1}, "horizontal accuracy"),
        ({"sigma_v": 8.1}, "vertical accuracy"),
        ({"sigma_speed": 2.1}, "speed accuracy"),
        ({"sigma_h": None, "sigma_v": None, "sigma_speed": None}, ""),
    ],
)
def test_objections(change: dict[str, Any], reason: str) -> None:
    assert objection(dataclasses.replace(GOOD, **change), SETTINGS) == reason


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, (1.0, 1.5, 0.4)),
        ({"sigma_h": 0.01, "sigma_v": 0.02, "sigma_speed": 0.01}, (0.5, 0.5, 0.3)),
        ({"sigma_h": 0.01, "sigma_v": 0.02, "sigma_speed": 0.01, "fix_type": 6}, (0.05, 0.05, 0.1)),
        ({"sigma_h": None, "sigma_v": None, "sigma_speed": None}, (1.5, 2.5, 0.5)),
    ],
)
def test_noise_is_the_reported_one_above_a_floor(
    change: dict[str, Any], expected: tuple[float, float, float]
) -> None:
    noise = noise_of(dataclasses.replace(GOOD, **change), SETTINGS)
    assert (noise.h, noise.v, noise.speed) == expected


def later(k: int, **change: Any) -> GnssFix:
    return dataclasses.replace(GOOD, t_us=200_000 * k, **change)


def test_three_good_fixes_open_the_gate() -> None:
    gate = StartGate(SETTINGS)
    assert gate.reason == "no GNSS fix yet"
    for k in range(3):
        assert not gate.passed
        gate.add(later(k), True)
    assert gate.passed


def test_a_bad_one_starts_the_count_again() -> None:
    gate = StartGate(SETTINGS)
    for k, fix_type in enumerate([3, 3, 1, 3, 3]):
        gate.add(later(k, fix_type=fix_type), True)
    assert not gate.passed
    assert gate.reason == "GNSS: 2 of 3 good fixes"
    gate.add(later(6, satellites=3), True)
    assert gate.reason == "GNSS: few satellites"


@pytest.mark.parametrize(("standing", "passes"), [(True, False), (False, True)])
def test_a_place_that_wanders_while_standing_is_not_used(standing: bool, passes: bool) -> None:
    gate = StartGate(SETTINGS)
    for k in range(20):
        gate.add(later(k, lat=0.8 + 12.0 * METRE * 0.2 * k), standing)
    assert gate.passed is passes


def test_a_speed_while_standing_is_not_used() -> None:
    gate = StartGate(SETTINGS)
    for k in range(10):
        gate.add(later(k, v_l=(1.5, 0.0, math.nan)), True)
    assert not gate.passed
    assert gate.reason == "GNSS: speed while standing"


def test_a_quiet_ride_is_not_taken_for_a_drift() -> None:
    gate = StartGate(SETTINGS)
    for k in range(20):
        gate.add(later(k, lat=0.8 + 12.0 * METRE * 0.2 * k, v_l=(12.0, 0.0, 0.0)), True)
    assert gate.passed
