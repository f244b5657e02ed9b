"""Noise-matched Monte-Carlo runs: the covariance must be as large as the errors are."""

from __future__ import annotations

import dataclasses

import pytest

from mavins.campaign.montecarlo import Series, montecarlo
from mavins.campaign.workers import Workers
from mavins.config import Config
from mavins.evaluation import compare
from mavins.evaluation.consistency import band, share_inside
from mavins.examples.scenarios import matched
from mavins.types import FloatArray
from sitl.gnss import MarkovSettings
from sitl.imu import TriadSettings
from sitl.scenario import Scenario, load

RUNS = 30
pytestmark = [pytest.mark.slow, pytest.mark.jit]


def without_model_errors(scenario: Scenario) -> Scenario:
    """The scenario with white noises and biases only."""

    def linear(triad: TriadSettings) -> TriadSettings:
        return dataclasses.replace(triad, scale_factor=0.0, quantum=0.0, full_scale=None)

    imu = scenario.imu
    matched = dataclasses.replace(imu, gyro=linear(imu.gyro), accel=linear(imu.accel))
    white = dataclasses.replace(
        scenario.gnss, markov_position=MarkovSettings(), markov_velocity=MarkovSettings()
    )
    return dataclasses.replace(scenario, imu=matched, gnss=white)


def mean_nees(
    scenario: Scenario, duration: float, runs: int, filter_name: str = "eskf"
) -> tuple[FloatArray, set[tuple[str, str]]]:
    """The mean NEES at each second from 30 s after the last start on, and what was refused and why.

    The filter's noises are the scenario's: nothing is added, no floor is felt.
    """
    config = matched(Config(), scenario)
    flown = montecarlo(Series(scenario, config, (filter_name,), runs, duration, 0), Workers(2))
    _, mean = compare.mean_nees([(f.nees_us, f.nees) for f in flown])
    return mean, {key for f in flown for key in f.refused}


CASES = [
    ("quad_mission", 145.0, "eskf"),
    ("square_spiral", 450.0, "eskf"),
    ("figure8", 110.0, "eskf"),
]
"""Every filter on all three takes a quarter of an hour: tests/bench/bench_consistency.py."""


@pytest.mark.parametrize(("name", "duration", "filter_name"), CASES)
@pytest.mark.timeout(600)
def test_mean_nees_keeps_its_band(name: str, duration: float, filter_name: str) -> None:
    mean, refused = mean_nees(without_model_errors(load(name)), duration, RUNS, filter_name)
    assert not refused
    assert len(mean) > 60
    assert share_inside(mean, dof=9, runs=RUNS) >= 0.9, f"mean NEES {mean.mean():.2f} of 9"


def test_the_band_is_the_one_of_chi_square() -> None:
    low, high = band(dof=9, runs=30)
    assert low == pytest.approx(7.545, abs=0.01)
    assert high == pytest.approx(10.58, abs=0.01)
