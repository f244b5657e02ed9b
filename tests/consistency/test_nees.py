"""Noise-matched Monte-Carlo runs: the covariance must be as large as the errors are."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from mavins.estimator.settings import (
    GnssSettings,
    HeadingSettings,
    ImuSettings,
    Settings,
    StatesSettings,
)
from mavins.evaluation.consistency import band, errors, nees, share_inside
from mavins.evaluation.montecarlo import Estimates, estimate
from mavins.nav.layout import X_SIZE
from mavins.types import FloatArray, Origin
from sitl.gnss import MarkovSettings
from sitl.imu import TriadSettings
from sitl.scenario import Scenario, load
from sitl.simulation import Measurements, TruthTable, simulate

RUNS = 30
SETTLED_US = 30_000_000
SECOND_US = 1_000_000
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


def matched_settings(scenario: Scenario) -> Settings:
    """The filter's noises are the scenario's: nothing is added, no floor is felt."""
    gyro, accel = scenario.imu.gyro, scenario.imu.accel
    return Settings(
        imu=ImuSettings(
            gyro_noise=gyro.noise,
            accel_noise=accel.noise,
            gyro_bias_walk=gyro.bias_walk,
            accel_bias_walk=accel.bias_walk,
            gyro_bias_sigma=gyro.bias,
            accel_bias_sigma=accel.bias,
        ),
        gnss=GnssSettings(delay=0.0, position_floor=1e-3, velocity_floor=1e-3),
        heading=HeadingSettings(sigma_deg=scenario.heading.sigma_deg),
        states=StatesSettings(gnss_delay="fixed"),
    )


def origin_of(scenario: Scenario) -> Origin:
    o = scenario.origin
    return Origin(math.radians(o.lat_deg), math.radians(o.lon_deg), o.alt)


def true_states(truth: TruthTable, estimates: Estimates) -> FloatArray:
    k = np.searchsorted(truth.t_us, estimates.t_us)
    assert np.array_equal(truth.t_us[k], estimates.t_us)
    x = np.zeros((len(k), X_SIZE))
    x[:, :16] = np.hstack(
        [truth.p_n[k], truth.v_n[k], truth.q_nb[k], truth.b_g[k], truth.b_a[k]],
    )
    return x


def series(
    scenario: Scenario, duration: float, runs: int, filter_name: str
) -> Iterator[tuple[Measurements, Estimates]]:
    """Simulate here, estimate in two other processes."""
    settings, origin = matched_settings(scenario), origin_of(scenario)
    scenario = dataclasses.replace(scenario, truth_rate=1)
    with ProcessPoolExecutor(2) as pool:
        jobs = []
        for seed in range(runs):
            m = simulate(scenario, seed, duration)
            fixes = [dataclasses.replace(fix, delay=scenario.gnss.latency) for fix in m.fixes]
            args = (settings, origin, m.imu, fixes, m.headings, SECOND_US, filter_name)
            jobs.append((m, pool.submit(estimate, *args)))
        for m, job in jobs:
            yield m, job.result()


def mean_nees(
    scenario: Scenario, duration: float, runs: int, filter_name: str = "eskf"
) -> tuple[FloatArray, set[tuple[str, str]]]:
    """The mean NEES at each second from 30 s after the last start on, and what was refused and why."""
    values, refused = [], set()
    for flight, estimates in series(scenario, duration, runs, filter_name):
        refused |= {key for key in estimates.decisions if key[1]}
        e = errors(true_states(flight.truth, estimates), estimates.x)
        values.append((estimates.t_us, nees(e, estimates.P)))
    begin = max(t_us[0] for t_us, _ in values) + SETTLED_US
    return np.mean([v[t_us >= begin] for t_us, v in values], axis=0), refused


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
