"""Further states in flight: lever arm and delay, a barometer that wanders, hard iron, gravity off the plumb line.

Each true value is drawn from what the filter is told of it at the start, and noises are those that it is told.
"""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimator.aiding_settings import BaroSettings, MagnetometerSettings
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.settings import Settings, StatesSettings
from mavins.evaluation.consistency import band, nees
from mavins.examples.scenarios import matched, origin_of
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import X_BARO, X_BM, X_G, X_L, X_SIZE, X_TAU, boxminus
from mavins.nav.rotations import quats_to_dcms
from mavins.nav.s2 import tilted
from mavins.types import (
    BaroSample,
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuTable,
    IntArray,
    MagSample,
)
from sitl.scenario import Scenario, load
from sitl.simulation import Measurements, TruthTable, simulate

pytestmark = [pytest.mark.slow, pytest.mark.jit]
RUNS = 5
DURATION = 80.0
SECOND_US = 1_000_000
EVERY_US = 200_000
SETTLED_S = 30
"""The covariances are judged from then on, after the start."""
NAVIGATION = 9
"""The errors of p, v and theta, before those of the further states."""


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
MATCHED = matched(Config(), SCENARIO)
Aid = GnssFix | HeadingFix | BaroSample | MagSample


@dataclass(frozen=True)
class Run:
    """A flight with further states: their errors beside those of p, v and theta, each second.

    e (N, 9 + n), P (N, 9 + n, 9 + n).
    """

    estimator: Estimator
    e: FloatArray
    P: FloatArray

    def nees(self, first: int = 0) -> FloatArray:
        """Of the errors from `first` on, at each second at which the filter has settled."""
        at = slice(SETTLED_S, None)
        return nees(self.e[at], self.P[at], np.arange(first, self.e.shape[1]))


def run(
    settings: Settings,
    imu: ImuTable,
    aids: Iterable[Aid],
    truth: TruthTable,
    tell: Callable[[FloatArray, int, Estimator], None],
    name: str = "eskf",
) -> Run:
    """Feed the estimator; `tell(x, t_us, estimator)` fills in what is true of the further states."""
    stamps: list[IntArray] = []
    states: list[FloatArray] = []
    covariances: list[FloatArray] = []

    def take(block: RowBlock, _: TangentFrame) -> None:
        rows = slice(0, block.count)
        stamps.append(block.t_us[rows].copy())
        states.append(block.x[rows].copy())
        covariances.append(block.P[rows].copy())

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
    x, P, t_us = np.concatenate(states), np.concatenate(covariances), np.concatenate(stamps)
    at = truth.t_us.searchsorted(t_us)
    true = np.zeros((len(x), X_SIZE))
    true[:, :16] = np.hstack(
        [column[at] for column in (truth.p_n, truth.v_n, truth.q_nb, truth.b_g, truth.b_a)]
    )
    columns = estimator.filter.layout.columns
    e = np.empty((len(x), len(columns)))
    for k, stamp in enumerate(t_us.tolist()):
        tell(true[k], stamp, estimator)
        e[k] = boxminus(true[k], x[k], columns)
    assert not any(one.rejected for one in estimator.statistics.values())
    which = np.r_[0:NAVIGATION, 15 : len(columns)]
    return Run(estimator, e[:, which], P[:, which[:, None], which])


def in_time(m: Measurements, *others: Iterable[Aid], delay: float = 0.0) -> Iterator[Aid]:
    fixes = [dataclasses.replace(fix, delay=delay) for fix in m.fixes]
    return heapq.merge(*others, fixes, key=lambda aid: aid.t_us)


def walk(rng: np.random.Generator, density: float, count: int, size: int) -> FloatArray:
    steps = rng.normal(size=(count, size)) * density * math.sqrt(EVERY_US * 1e-6)
    return np.cumsum(steps, axis=0)


def every(m: Measurements) -> IntArray:
    """The rows of the truth at which a slow sensor reads."""
    return m.truth.t_us.searchsorted(np.arange(m.imu.t_us[0], m.imu.t_us[-1], EVERY_US))


def lever_and_delay(seed: int, duration: float) -> Run:
    """The antenna is 0.5 m off on each axis, and the fixes 0.2 s late, give or take 0.05 s."""
    rng = np.random.default_rng([seed, 1])
    lever, delay = 0.5 * rng.normal(size=3), 0.2 + 0.05 * rng.normal()
    gnss = dataclasses.replace(SCENARIO.gnss, lever_arm=tuple(lever.tolist()), latency=delay)
    m = simulate(dataclasses.replace(SCENARIO, gnss=gnss), seed, duration)
    states = StatesSettings(
        lever_arm="estimate", lever_arm_sigma=0.5, gnss_delay="estimate", gnss_delay_sigma=0.05
    )
    told = dataclasses.replace(MATCHED.gnss, delay=0.2)
    settings = dataclasses.replace(MATCHED, gnss=told, states=states)

    def tell(x: FloatArray, t_us: int, _: Estimator) -> None:
        x[X_L], x[X_TAU] = lever, delay

    return run(settings, m.imu, in_time(m, m.headings, delay=0.2), m.truth, tell)


def wandering_barometer(seed: int, duration: float) -> Run:
    """The barometer is ten times better than GNSS, but for its walk."""
    states = StatesSettings(
        gnss_delay="fixed", baro_bias="estimate", baro_bias_sigma=5.0, baro_bias_walk=0.1
    )
    settings = dataclasses.replace(
        MATCHED, states=states, baro=BaroSettings(sigma=0.1, max_rate=20.0)
    )
    m = simulate(SCENARIO, seed, duration)
    rng = np.random.default_rng([seed, 1])
    at = every(m)
    alt = np.array([FRAME.to_lla(m.truth.p_n[k])[2] for k in at])
    bias = 247.0 + walk(rng, 0.1, len(at), 1)[:, 0]
    read = alt + bias + 0.1 * rng.normal(size=len(at))
    samples = [BaroSample(int(m.truth.t_us[k]), z) for k, z in zip(at, read, strict=True)]

    def tell(x: FloatArray, t_us: int, estimator: Estimator) -> None:
        x[X_BARO] = np.interp(t_us, m.truth.t_us[at], bias) - estimator._measuring.barometer.base

    return run(settings, m.imu, in_time(m, m.headings, samples), m.truth, tell)


def hard_iron(seed: int, duration: float, name: str = "eskf") -> Run:
    """No heading but the magnetometer's, in counts of an unknown scale."""
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
    settings = dataclasses.replace(MATCHED, states=states, magnetometer=compass)
    m = simulate(SCENARIO, seed, duration)
    rng = np.random.default_rng([seed, 1])
    at = every(m)
    bias = 0.06 * rng.normal(size=3) + walk(rng, 1e-3, len(at), 3)
    field_b = np.einsum("kij,i->kj", quats_to_dcms(m.truth.q_nb[at]), field_n)
    read = 480.0 * (field_b + bias + 0.02 * rng.normal(size=(len(at), 3)))
    samples = [MagSample(int(m.truth.t_us[k]), z) for k, z in zip(at, read, strict=True)]

    def tell(x: FloatArray, t_us: int, _: Estimator) -> None:
        x[X_BM] = bias[m.truth.t_us[at].searchsorted(t_us)]

    return run(settings, m.imu, in_time(m, samples), m.truth, tell, name)


def tilted_gravity(seed: int, duration: float, name: str = "eskf") -> Run:
    """Gravity is 1 deg off the plumb line about north and about east, in accelerated flight with a heading."""
    t = np.radians(np.random.default_rng([seed, 1]).normal(size=2))
    m = simulate(SCENARIO, seed, duration)
    off = np.empty((len(m.imu), 3))
    for k in range(len(m.imu)):
        g_n = gravity_n(m.truth.p_n[k], FRAME.r0_e, FRAME.C_ne)
        off[k] = np.array(tilted((t[0], t[1]), (g_n[0], g_n[1], g_n[2]))) - g_n
    accel_b = m.imu.accel_b - np.einsum("kij,ki->kj", quats_to_dcms(m.truth.q_nb), off)
    settings = dataclasses.replace(
        MATCHED, states=StatesSettings(gnss_delay="fixed", gravity="estimate")
    )

    def tell(x: FloatArray, t_us: int, _: Estimator) -> None:
        x[X_G] = t

    imu = dataclasses.replace(m.imu, accel_b=accel_b)
    return run(settings, imu, in_time(m, m.headings), m.truth, tell, name)


BLOCKS: Final[dict[str, Callable[[int, float], Run]]] = {
    "lever_and_delay": lever_and_delay,
    "wandering_barometer": wandering_barometer,
    "hard_iron": hard_iron,
    "tilted_gravity": tilted_gravity,
}


@pytest.mark.parametrize("block", BLOCKS)
def test_covariances_are_as_large_as_the_errors(block: str) -> None:
    """So few runs leave single instants, whose errors last for seconds, to chance: their mean is judged.

    Thirty runs, and the share of the seconds inside the band: tests/bench/bench_consistency.py --blocks.
    """
    flown = [BLOCKS[block](seed, DURATION) for seed in range(RUNS)]
    for first in (0, NAVIGATION):
        low, high = band(flown[0].e.shape[1] - first, RUNS)
        assert low < np.mean([one.nees(first) for one in flown]) < high
