"""A barometer's level: learnt from GNSS, slow, and begun anew after a jump."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavins.estimator.aiding_settings import BaroSettings
from mavins.estimator.barometer import Barometer
from mavins.types import BaroSample

STEP_US = 1_000_000


def test_nothing_before_a_fix_and_nothing_when_off() -> None:
    barometer = Barometer(BaroSettings())
    assert barometer.altitude(BaroSample(0, 5.0)) is None
    barometer.see_fix(600_001, 247.0, 2.0)  # the reading is too old to compare
    assert barometer.altitude(BaroSample(STEP_US, 5.0)) is None
    off = Barometer(BaroSettings(enabled=False))
    off.altitude(BaroSample(0, 5.0))
    off.see_fix(0, 247.0, 2.0)
    assert off.altitude(BaroSample(0, 5.0)) is None


def test_level_is_averaged_and_its_sigma_is_honest() -> None:
    settings = BaroSettings(sigma=1.0, drift=0.0, max_rate=10.0)
    errors, sigmas = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        barometer = Barometer(settings)
        for k in range(50):
            barometer.altitude(BaroSample(k * STEP_US, 5.0 + rng.normal()))
            barometer.see_fix(k * STEP_US, 247.0 + 2.0 * rng.normal(), 2.0)
        level = barometer.altitude(BaroSample(50 * STEP_US, 15.0))
        assert level is not None
        errors.append(level[0] - 257.0)
        sigmas.append(math.sqrt(level[1] ** 2 - settings.sigma**2))
    assert sigmas[0] == pytest.approx(math.sqrt(5.0 / 50.0), rel=1e-6)
    assert np.std(errors) == pytest.approx(sigmas[0], rel=0.15)


def test_a_jump_to_another_level_is_not_taken_for_height() -> None:
    """As a recorder does whose barometer starts up: 237 m, then 5 m."""
    barometer = Barometer(BaroSettings())
    alts = [237.0] * 5 + [5.0] * 5
    for k, alt in enumerate(alts):
        barometer.altitude(BaroSample(k * STEP_US, alt))
        barometer.see_fix(k * STEP_US, 247.0, 2.0)
        if k in (5, 6):
            assert barometer.offset == pytest.approx(-10.0)
    assert barometer.offset == pytest.approx(-242.0)
    level = barometer.altitude(BaroSample(20 * STEP_US, 6.0))
    assert level is not None
    assert level[0] == pytest.approx(248.0)


def test_no_more_than_the_highest_rate() -> None:
    barometer = Barometer(BaroSettings(max_rate=5.0))
    barometer.altitude(BaroSample(0, 5.0))
    barometer.see_fix(0, 247.0, 2.0)
    taken = [
        t for t in range(0, 1_000_000, 20_000) if barometer.altitude(BaroSample(t, 5.0)) is not None
    ]
    assert taken == [0, 200_000, 400_000, 600_000, 800_000]


def test_with_its_bias_in_the_filter_only_the_first_difference_and_jumps_are_taken_away() -> None:
    settings = BaroSettings(sigma=1.0, drift=0.2, max_rate=10.0)
    barometer, beside = Barometer(settings, bias_in_filter=True), Barometer(settings)
    for k in range(60):
        # it wanders by 4 m, and then its level falls by 100 m
        alt = 5.0 + 4.0 * min(k, 40) / 40 - 100.0 * (k > 50)
        for one in (barometer, beside):
            one.altitude(BaroSample(k * STEP_US, alt))
            one.see_fix(k * STEP_US, 247.0, 2.0)
        if k == 45:
            level = barometer.altitude(BaroSample(k * STEP_US + 500_000, alt))
            assert level == (251.0, 1.0)
            assert beside.offset == pytest.approx(-238.0, abs=1.0)
    level = barometer.altitude(BaroSample(61 * STEP_US, -91.0))
    assert level is not None
    assert level[0] == pytest.approx(251.0, abs=0.5)
