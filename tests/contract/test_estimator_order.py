"""The estimate depends on what arrives in which order, not on how many rows are handed over at a time."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.fusion import Event
from mavins.estimator.settings import GnssSettings, HeadingSettings, Settings, StatesSettings
from mavins.filters import REGISTRY, RowBlock
from mavins.nav.earth import TangentFrame
from mavins.types import BaroSample, FloatArray, GnssFix, HeadingFix, ImuTable, MagSample
from sitl.imu import ImuSettings, TriadSettings
from sitl.scenario import load
from sitl.simulation import Measurements, simulate

Arrival: TypeAlias = int | GnssFix | HeadingFix | MagSample | BaroSample
"""What arrives: the number of an IMU row, or a measurement."""

DURATION = 22.0
FLYING_US = 12_000_000
DELAY = 0.1234
HEADING_DELAY = 0.0224
"""Headings and fixes are valid between IMU rows, at times between the same two."""
SETTINGS = Settings(
    gnss=dataclasses.replace(GnssSettings(), delay=0.0, lever_arm=(0.1, 0.0, -0.2)),
    heading=HeadingSettings(sigma_deg=2.0),
    # a fix is placed by the delay that is believed when it comes: one that is estimated sees the order of arrival
    states=StatesSettings(gnss_delay="fixed"),
    # the field made up here is a rough one
    magnetometer=MagnetometerSettings(
        enabled=True,
        delay=HEADING_DELAY,
        sigma=0.9,
        rotation=(0.0, 0.0, 0.3),
        hard_iron=(10.0, 0.0, -5.0),
        declination_deg=4.0,
        inclination_deg=60.0,
    ),
)
pytestmark = pytest.mark.jit


@functools.cache
def flight() -> Measurements:
    scenario = load("quad_mission")
    triad = TriadSettings(noise=1e-3, bias=0.01)
    scenario = dataclasses.replace(
        scenario,
        imu=ImuSettings(rate=100, gyro=triad, accel=dataclasses.replace(triad, noise=1e-2)),
        gnss=dataclasses.replace(scenario.gnss, latency=DELAY),
        heading=dataclasses.replace(scenario.heading, rate=10),
        truth_rate=1,
    )
    return simulate(scenario, 4, DURATION)


def fields() -> list[MagSample]:
    rng = np.random.default_rng(8)
    stamps = range(0, round(DURATION * 1e6), 107_000)
    return [MagSample(t, rng.normal(size=3) * 9.0 + [200.0, 0.0, 350.0]) for t in stamps]


def arrivals(
    lateness_us: int = 0, from_us: int = 0, displaced: int = 0, seed: int = 0
) -> list[Arrival]:
    """The flight in the order of its arrival; fixes stamped after `from_us` come `lateness_us` after their stamp,
    `displaced` IMU rows come up to 0.4 s late."""
    m = flight()
    rng = np.random.default_rng(seed)
    place = np.arange(len(m.imu))
    place[rng.integers(900, len(place) - 50, displaced)] += rng.integers(1, 40, displaced)
    rows: list[Arrival] = np.argsort(place, kind="stable").tolist()
    timed: list[tuple[int, int, Arrival]]
    timed = [(int(m.imu.t_us[k]), 0, row) for k, row in enumerate(rows)]
    timed += [(h.t_us, 1, dataclasses.replace(h, delay=HEADING_DELAY)) for h in m.headings]
    timed += [(field.t_us, 3, field) for field in fields()]
    for fix in m.fixes:
        late = lateness_us if fix.t_us >= from_us else 0
        timed.append((fix.t_us + late, 2, dataclasses.replace(fix, delay=DELAY)))
    return [what for *_, what in sorted(timed, key=lambda item: item[:2])]


def grouped(stream: Sequence[Arrival], sizes: Iterator[int]) -> Iterator[list[int] | Arrival]:
    """Neighbouring IMU rows joined to groups of the given sizes."""
    group: list[int] = []
    size = next(sizes)
    for what in stream:
        if isinstance(what, int):
            group.append(what)
            if len(group) < size:
                continue
        if group:
            yield group
            group, size = [], next(sizes)
        if not isinstance(what, int):
            yield what
    if group:
        yield group


@dataclasses.dataclass
class Outcome:
    rows: list[tuple[int, bytes, bytes, bytes]]
    decisions: list[tuple[int, str, str, str]]
    x: FloatArray
    P: FloatArray
    resets: int


def run(filter_name: str, stream: Sequence[Arrival], sizes: Iterator[int]) -> Outcome:
    rows: list[tuple[int, bytes, bytes, bytes]] = []
    decisions: list[tuple[int, str, str, str]] = []

    def take(block: RowBlock, _: TangentFrame) -> None:
        rows.extend(
            (int(block.t_us[k]), block.x[k].tobytes(), block.u[k].tobytes(), block.P[k].tobytes())
            for k in range(block.count)
        )

    def decide(event: Event) -> None:
        m = event.measurement
        numbers = (event.nis, *event.innovation.tolist(), *event.sigma.tolist())
        decisions.append((m.t_us, m.aiding, event.reason, repr(numbers)))

    estimator = Estimator(SETTINGS, filter_name, Outputs(20_000, take, decide))
    imu = flight().imu
    for what in grouped(stream, sizes):
        if isinstance(what, list):
            k = np.array(what)
            estimator.feed_imu(ImuTable(imu.t_us[k], imu.accel_b[k], imu.gyro_b[k]))
        elif isinstance(what, GnssFix):
            estimator.feed_gnss(what)
        elif isinstance(what, MagSample):
            estimator.feed_mag(what)
        elif isinstance(what, BaroSample):
            estimator.feed_baro(what)
        else:
            estimator.feed_heading(what)
    estimator.finish()
    solution = estimator.solution()
    assert solution is not None
    x = np.concatenate([solution.p_n, solution.v_n, solution.q_nb, solution.b_g, solution.b_a])
    return Outcome(rows, decisions, x, solution.P, estimator.reset_counter)


def with_baro(stream: Sequence[Arrival]) -> Iterator[Arrival]:
    """An altitude after each fix. Its level is learnt in the order of arrival: a late fix does change it."""
    for what in stream:
        yield what
        if isinstance(what, GnssFix):
            yield BaroSample(what.t_us, what.alt - 30.0)


def ones() -> Iterator[int]:
    while True:
        yield 1


def alls() -> Iterator[int]:
    while True:
        yield 10**9


def random_sizes(seed: int) -> Iterator[int]:
    rng = np.random.default_rng(seed)
    while True:
        yield int(rng.integers(1, 40))


STREAMS = {
    "in time": {},
    "fixes 0.2 s late": {"lateness_us": 200_000},
    "fixes 50 ms early": {"lateness_us": -50_000 - round(DELAY * 1e6)},
    "IMU reordered": {"displaced": 100},
    "all of it": {"lateness_us": 730_000, "displaced": 100},
}


@pytest.mark.parametrize("filter_name", REGISTRY)
@pytest.mark.parametrize("stream", STREAMS)
def test_grouping_changes_nothing(filter_name: str, stream: str) -> None:
    order = list(with_baro(arrivals(**STREAMS[stream], seed=1)))
    single = run(filter_name, order, ones())
    assert len(single.rows) > 600
    assert len({d[1] for d in single.decisions}) == 7
    for sizes in (alls(), random_sizes(1), random_sizes(2)):
        other = run(filter_name, order, sizes)
        assert other.decisions == single.decisions
        assert other.rows == single.rows
        assert_array_equal(other.x, single.x)
        assert_array_equal(other.P, single.P)


@pytest.mark.parametrize("filter_name", REGISTRY)
@pytest.mark.parametrize("lateness_us", [30_000, 200_000, 850_000])
def test_a_late_fix_is_fused_where_it_belongs(filter_name: str, lateness_us: int) -> None:
    stream = [
        what
        for what in arrivals(lateness_us, FLYING_US)
        # the last fixes would not arrive before the end
        if not (isinstance(what, GnssFix) and what.t_us > (DURATION - 0.9) * 1e6)
    ]
    kept = {id(what) for what in stream if isinstance(what, GnssFix)}
    assert len(kept) > 90
    last_us = max(what.t_us for what in stream if isinstance(what, GnssFix))
    in_time = run(
        filter_name,
        [w for w in arrivals() if not (isinstance(w, GnssFix) and w.t_us > last_us)],
        ones(),
    )
    late = run(filter_name, stream, random_sizes(5))
    assert_array_equal(late.x, in_time.x)
    assert_array_equal(late.P, in_time.P)
    assert sorted(late.decisions, key=str) == sorted(in_time.decisions, key=str)


@pytest.mark.parametrize("filter_name", REGISTRY)
def test_reordered_samples_end_in_the_same_state(filter_name: str) -> None:
    in_order = run(filter_name, arrivals(), ones())
    shuffled = run(filter_name, arrivals(displaced=200, seed=3), ones())
    assert_array_equal(shuffled.x, in_order.x)
    assert_array_equal(shuffled.P, in_order.P)


@pytest.mark.parametrize("filter_name", REGISTRY)
def test_what_comes_too_late_is_counted_and_left_out(filter_name: str) -> None:
    late = run(filter_name, arrivals(1_500_000, FLYING_US), ones())
    arrived = (d for d in late.decisions if FLYING_US < d[0] < (DURATION - 1.0) * 1e6)
    reasons = {reason for _, aiding, reason, *_ in arrived if aiding.startswith("gnss")}
    assert reasons == {"too old"}
    assert math.isfinite(float(late.x.sum()))
