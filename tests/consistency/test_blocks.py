"""Further states in flight: a barometer that wanders, a magnetometer with hard iron, gravity off the plumb line."""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimator.aiding_settings import BaroSettings, MagnetometerSettings
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.settings import Settings, StatesSettings
from mavins.evaluation.consistency import band
from mavins.examples.scenarios import matched, origin_of
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import X_BARO, X_BM, X_SIZE, boxminus
from mavins.nav.s2 import tilted
from mavins.nav.so3 import quat_to_dcm
from mavins.types import (
    BaroSample,
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuTable,
    MagSample,
)
from sitl.scenario import Scenario, load
from sitl.simulation import Measurements, simulate

pytestmark = [pytest.mark.slow, pytest.mark.jit]
RUNS = 5
SECOND_US = 1_000_000
EVERY_US = 200_000


def white(name: str) -> Scenario:
    """A scenario with white noises and biases only, and few headings, which take most of the time."""
    scenario = load(name)
    gyro, accel = (
        dataclasses.replace(triad, scale_factor=0.0, quantum=0.0, full_scale=None)
        for triad in (scenario.imu.gyro, scenario.imu.accel)
    )
    return dataclasses.replace(
        scenario,
        imu=dataclasses.replace(scenario.imu, gyro=gyro, accel=accel),
        heading=dataclasses.replace(scenario.heading, rate=5),
    )


SCENARIO = white("quad_mission")
FRAME = TangentFrame.at(origin_of(SCENARIO))
DURATION = 80.0
Aid = GnssFix | HeadingFix | BaroSample | MagSample


def flight(seed: int) -> Measurements:
    return simulate(SCENARIO, seed, DURATION)


def true_state(m: Measurements, k: int) -> FloatArray:
    x = np.zeros(X_SIZE)
    truth = m.truth
    x[:16] = np.hstack([truth.p_n[k], truth.v_n[k], truth.q_nb[k], truth.b_g[k], truth.b_a[k]])
    return x


def estimated(
    settings: Settings, imu: ImuTable, aids: Iterable[Aid], name: str = "eskf"
) -> tuple[Estimator, list[tuple[int, FloatArray, FloatArray]]]:
    """The estimator at the end, and (t_us, x, P) each second."""
    rows: list[tuple[int, FloatArray, FloatArray]] = []

    def take(block: RowBlock, _: TangentFrame) -> None:
        n = block.count
        rows.extend(
            zip(block.t_us[:n].tolist(), block.x[:n].copy(), block.P[:n].copy(), strict=True)
        )

    estimator = Estimator(settings, name, Outputs(SECOND_US, take))
    estimator.set_origin(origin_of(SCENARIO))
    start = 0
    for aid in aids:
        end = int(imu.t_us.searchsorted(aid.t_us, "right"))
        if end > start:
            part = slice(start, end)
            estimator.feed_imu(ImuTable(imu.t_us[part], imu.accel_b[part], imu.gyro_b[part]))
            start = end
        match aid:
            case GnssFix():
                estimator.feed_gnss(aid)
            case HeadingFix():
                estimator.feed_heading(aid)
            case BaroSample():
                estimator.feed_baro(aid)
            case MagSample():
                estimator.feed_mag(aid)
    estimator.finish()
    return estimator, rows


def in_time(m: Measurements, *others: Iterable[Aid]) -> Iterator[Aid]:
    fixes = [dataclasses.replace(fix, delay=SCENARIO.gnss.latency) for fix in m.fixes]
    return heapq.merge(*others, fixes, key=lambda aid: aid.t_us)


def walk(rng: np.random.Generator, density: float, count: int, size: int) -> FloatArray:
    steps = rng.normal(size=(count, size)) * density * math.sqrt(EVERY_US * 1e-6)
    return np.cumsum(steps, axis=0)


def mean_in_band(values: list[list[float]], dof: int) -> None:
    """So few runs leave single instants, whose errors last for seconds, to chance: their mean is judged."""
    low, high = band(dof, RUNS)
    assert low < np.mean(values) < high


def nees_of(e: FloatArray, P: FloatArray) -> float:
    return float(e @ np.linalg.solve(P, e))


def test_a_barometer_that_wanders() -> None:
    """NEES over p, v, theta and b_baro; the barometer is ten times better than GNSS, but for its walk."""
    states = StatesSettings(
        gnss_delay="fixed", baro_bias="estimate", baro_bias_sigma=5.0, baro_bias_walk=0.1
    )
    settings = dataclasses.replace(
        matched(Config(), SCENARIO), states=states, baro=BaroSettings(sigma=0.1, max_rate=20.0)
    )
    which = np.r_[0:9, 15]
    values, sigmas = [], []
    for seed in range(RUNS):
        m = flight(seed)
        rng = np.random.default_rng(seed)
        at = np.searchsorted(m.truth.t_us, np.arange(m.imu.t_us[0], m.imu.t_us[-1], EVERY_US))
        alt = np.array([FRAME.to_lla(m.truth.p_n[k])[2] for k in at])
        bias = 247.0 + walk(rng, 0.1, len(at), 1)[:, 0]
        read = alt + bias + 0.1 * rng.normal(size=len(at))
        samples = [BaroSample(int(m.truth.t_us[k]), z) for k, z in zip(at, read, strict=True)]
        estimator, rows = estimated(settings, m.imu, in_time(m, m.headings, samples))
        assert estimator.statistics["baro"].accepted > 300
        assert not estimator.statistics["baro"].rejected
        run = []
        for t_us, x, P in rows[-40:]:
            k = int(np.searchsorted(m.truth.t_us, t_us))
            truth = true_state(m, k)
            truth[X_BARO] = (
                np.interp(t_us, m.truth.t_us[at], bias) - estimator._measuring.barometer.base
            )
            e = boxminus(truth, x, estimator.filter.layout.columns)
            run.append(nees_of(e[which], P[np.ix_(which, which)]))
        values.append(run)
        sigmas.append(math.sqrt(rows[-1][2][15, 15]))
    mean_in_band(values, len(which))
    assert max(sigmas) < 0.4


def test_hard_iron() -> None:
    """NEES over p, v, theta and b_m, with no heading but the magnetometer's, in counts of an unknown scale."""
    dip, declination = math.radians(60.0), math.radians(3.0)
    field_n = np.array(
        [
            math.cos(dip) * math.cos(declination),
            math.cos(dip) * math.sin(declination),
            math.sin(dip),
        ]
    )
    states = StatesSettings(
        gnss_delay="fixed", mag_bias="estimate", mag_bias_sigma=0.06, mag_bias_walk=1e-3
    )
    compass = MagnetometerSettings(
        enabled=True,
        max_rate=20.0,
        sigma=0.02,
        rotation=(0.0, 0.0, 0.0),
        hard_iron=(0.0, 0.0, 0.0),
        declination_deg=3.0,
        inclination_deg=60.0,
    )
    settings = dataclasses.replace(matched(Config(), SCENARIO), states=states, magnetometer=compass)
    which = np.r_[0:9, 15:18]
    values, worst = [], 0.0
    for seed in range(RUNS):
        m = flight(seed)
        rng = np.random.default_rng(seed)
        at = np.searchsorted(m.truth.t_us, np.arange(m.imu.t_us[0], m.imu.t_us[-1], EVERY_US))
        bias = 0.06 * rng.normal(size=3) + walk(rng, 1e-3, len(at), 3)
        samples = []
        for k, b in zip(at.tolist(), bias, strict=True):
            field_b = quat_to_dcm(m.truth.q_nb[k]).T @ field_n + b + 0.02 * rng.normal(size=3)
            samples.append(MagSample(int(m.truth.t_us[k]), 480.0 * field_b))
        estimator, rows = estimated(settings, m.imu, in_time(m, samples))
        assert estimator.statistics["magnetometer"].accepted > 300
        run = []
        for t_us, x, P in rows[-40:]:
            truth = true_state(m, int(np.searchsorted(m.truth.t_us, t_us)))
            truth[X_BM] = bias[np.searchsorted(m.truth.t_us[at], t_us)]
            e = boxminus(truth, x, estimator.filter.layout.columns)
            run.append(nees_of(e[which], P[np.ix_(which, which)]))
        values.append(run)
        worst = max(worst, float(np.abs(e[15:18]).max()))
    mean_in_band(values, len(which))
    assert worst < 0.04


@pytest.mark.parametrize("name", ["eskf", "ieskf"])
def test_gravity_off_the_plumb_line_is_found(name: str) -> None:
    """A tilt of 1 deg, about an axis between north and east, in accelerated flight with a heading."""
    t = (math.radians(0.6), math.radians(-0.8))
    m = flight(1)
    accel_b = m.imu.accel_b.copy()
    for k in range(len(m.imu)):
        g_n = gravity_n(m.truth.p_n[k], FRAME.r0_e, FRAME.C_ne)
        off = np.array(tilted(t, (g_n[0], g_n[1], g_n[2]))) - g_n
        accel_b[k] -= quat_to_dcm(m.truth.q_nb[k]).T @ off
    settings = dataclasses.replace(
        matched(Config(), SCENARIO), states=StatesSettings(gnss_delay="fixed", gravity="estimate")
    )
    imu = dataclasses.replace(m.imu, accel_b=accel_b)
    estimator, rows = estimated(settings, imu, in_time(m, m.headings), name)
    t_us, x, P = rows[-1]
    truth = true_state(m, int(np.searchsorted(m.truth.t_us, t_us)))
    truth[24:26] = t
    e = boxminus(truth, x, estimator.filter.layout.columns)
    sigma = np.sqrt(np.diag(P))
    assert np.all(np.abs(e[15:]) < 3.0 * sigma[15:])
    assert np.all(sigma[15:] < math.radians(0.3))
    assert nees_of(e, P) < 40.0
