"""What goes in together has the outcome of what goes in one after the other, to the last bit."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from mavins.aiding import Measurement, gnss_position, heading, zero_velocity
from mavins.estimator import timeline
from mavins.estimator.aiding_settings import BaroSettings, MagnetometerSettings
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.feed import Between, Feed, by_turns
from mavins.estimator.fusion import Event
from mavins.estimator.passage import SNAPSHOT_US, Passage, Rows, Stepwise, Visit, passage_of
from mavins.estimator.settings import Settings
from mavins.filters import Filter, FilterState, ImuNoise, RowBlock, make
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, X_SIZE, Layout
from mavins.types import (
    BaroSample,
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuTable,
    MagSample,
    Origin,
    Reading,
)

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

FRAME = TangentFrame.at(Origin(0.8, 0.15, 500.0))
LAYOUT = Layout.of((*CORE, "tau"))
REASONS = {"", "gate", "too old", "too far ahead"}
SETTINGS = Settings(
    magnetometer=MagnetometerSettings(enabled=True, declination_deg=0.0, inclination_deg=60.0),
    baro=BaroSettings(enabled=True),
)


class Kept:
    """All that an estimator says."""

    def __init__(self, settings: Settings) -> None:
        self.rows: list[FloatArray] = []
        self.decisions: list[tuple[object, ...]] = []
        self.estimator = Estimator(settings, "eskf", Outputs(20_000, self._row, self._decision))

    def _row(self, block: RowBlock, frame: TangentFrame) -> None:
        n = block.count
        flat = block.P[:n].reshape(n, -1)
        self.rows.append(np.column_stack([block.t_us[:n], block.x[:n], block.u[:n], flat]))

    def _decision(self, event: Event) -> None:
        said = (event.reason, event.nis, event.innovation.tolist(), event.S.tolist())
        self.decisions.append((*event.order[:3], *said))

    def all(self) -> tuple[FloatArray, list[tuple[object, ...]], list[object]]:
        e = self.estimator
        state = [e.health, e.reason, e.reset_counter, e.realignments, dict(e.dropped), e.imu_rows]
        return np.concatenate(self.rows), self.decisions, state


def stream(rng: np.random.Generator) -> list[ImuTable | GnssFix | Reading]:
    """20 s of a standing vehicle: samples lost, late, repeated; readings early, in place, late and wrong."""
    feeds: list[ImuTable | GnssFix | Reading] = []
    skipped = set(rng.choice(np.arange(600, 1000), 40).tolist()) | set(range(900, 960))
    for k in range(1000):
        t_us = 1_000_000 + 20_000 * k
        if k not in skipped:
            late = -60_000 if rng.random() < 0.03 else 0
            accel, gyro = (rng.normal(size=(1, 3)) * sigma for sigma in (0.05, 0.005))
            feeds.append(ImuTable(np.array([t_us + late]), accel - [0.0, 0.0, 9.808], gyro))
        if k % 10 == 0:
            fix = GnssFix(
                t_us - 30_000, *FRAME.to_lla(rng.normal(size=3) * 0.5), (0.0, 0.0, 0.0), 3, 12
            )
            feeds.append(fix)
        for reading in (
            HeadingFix(t_us, rng.normal() * 0.05, 0.05),
            MagSample(t_us, np.array([0.5, 0.0, 0.87]) + rng.normal(size=3) * 0.01),
            BaroSample(t_us, rng.normal() * 0.3),
        ):
            if rng.random() < 0.5:
                shift = int(
                    rng.choice([0, 0, 0, 5_000, 45_000, -7_000, -90_000, 3_000_000, -3_000_000])
                )
                feeds.append(type(reading)(t_us + shift, *_rest(reading)))
    return feeds


def _rest(reading: Reading) -> tuple[object, ...]:
    match reading:
        case HeadingFix():
            return (3.0 if reading.yaw > 0.12 else reading.yaw, reading.sigma)
        case MagSample():
            return (reading.field,)
        case BaroSample():
            return (reading.alt,)


def fed(
    feeds: Sequence[ImuTable | GnssFix | Reading],
    together: int,
    give: Callable[[Feed, ImuTable, Sequence[Between]], None],
) -> Kept:
    """The stream into an estimator, at most so many samples at a time."""
    kept = Kept(SETTINGS)
    tables: list[ImuTable] = []
    between: list[Between] = []

    def hand_over() -> None:
        if tables:
            table = ImuTable(
                np.concatenate([table.t_us for table in tables]),
                np.concatenate([table.accel_b for table in tables]),
                np.concatenate([table.gyro_b for table in tables]),
            )
            give(kept.estimator, table, between)
            tables.clear()
            between.clear()

    for item in feeds:
        if isinstance(item, ImuTable):
            if len(tables) == together:
                hand_over()
            tables.append(item)
        elif isinstance(item, GnssFix):
            hand_over()
            kept.estimator.feed_gnss(item)
        else:
            between.append((len(tables), item))
    hand_over()
    kept.estimator.finish()
    return kept


def same(a: Kept, b: Kept) -> None:
    (rows_a, decisions_a, state_a), (rows_b, decisions_b, state_b) = a.all(), b.all()
    assert state_a == state_b
    assert np.array_equal(rows_a, rows_b)
    assert repr(decisions_a) == repr(decisions_b)


@pytest.mark.parametrize("seed", range(4))
def test_a_run_is_its_parts(seed: int) -> None:
    feeds = stream(np.random.default_rng(seed))
    one_by_one = fed(feeds, 1, by_turns)
    assert {reason for *_, reason, _, _, _ in one_by_one.decisions} >= REASONS
    assert one_by_one.estimator.dropped
    for together in (3, 1000):
        same(one_by_one, fed(feeds, together, lambda feed, *what: feed.feed_run(*what)))


def test_the_kernel_goes_the_same_way_as_single_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    feeds = stream(np.random.default_rng(9))
    compiled = fed(feeds, 1000, lambda feed, *what: feed.feed_run(*what))
    monkeypatch.setattr(timeline, "passage_of", Stepwise)
    same(compiled, fed(feeds, 1000, lambda feed, *what: feed.feed_run(*what)))


def start(algorithm: Filter) -> FilterState:
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    state = FilterState(x, np.eye(16) * 0.01, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.8]), 0)
    algorithm.adopt(state)
    return state


def through(
    passage: Passage, measurements: Sequence[Measurement]
) -> tuple[FilterState, list[Event], int]:
    """A second of 100 Hz rows and measurements; how often the passage stopped."""
    state, out = start(passage._filter), RowBlock.empty(200, 16)  # type: ignore[attr-defined]
    t_us = np.arange(1, 101) * 10_000
    imu = np.tile(state.u, (100, 1)) + np.random.default_rng(1).normal(size=(100, 6)) * 0.01
    events = [Event(m, (m.t_us, m.rank, m.source, k)) for k, m in enumerate(measurements)]
    done, stops, last_us = 0, 0, 0
    visits: list[Visit] = []
    while done < len(events) or state.t_us < t_us[-1]:
        first = int(t_us.searchsorted(state.t_us, "right"))
        before_us = 0 if first == 0 else int(t_us[first - 1])
        rows = Rows(t_us[first:], imu[first:], before_us, int(t_us[-1]), 0, out)
        count, some = passage.go(state, FRAME, rows, events[done:], last_us)
        done += count
        stops += 1
        visits += some
        last_us = visits[-1].state.t_us if visits else 0
    stamps = [visit.state.t_us for visit in visits]
    assert all(b - a >= SNAPSHOT_US for a, b in itertools.pairwise(stamps))
    assert out.count == 100
    return state, events, stops


def test_it_stops_behind_a_refused_fix_and_nowhere_else() -> None:
    here, there = (FRAME.to_lla(np.array([p, 0.0, 0.0])) for p in (0.0, 100.0))
    gate = 5.0

    def fix(t_us: int, lla: FloatArray, quality: str = "") -> Measurement:
        return gnss_position.measure(
            GnssFix(t_us, *lla, None, 3), t_us, FRAME, 1.0, 1.0, gate, quality
        )

    measurements = [
        heading.measure(HeadingFix(0, 0.01), 105_000, FRAME, 0.1, gate),
        heading.measure(HeadingFix(0, 3.0), 110_000, FRAME, 0.1, gate),
        fix(110_000, here),
        fix(333_333, there),
        fix(400_000, there, "few satellites"),
        zero_velocity.measure(500_000, 500_000, 0.1, gate),
        heading.measure(HeadingFix(0, 0.0), 1_000_000, FRAME, 0.1, gate),
    ]
    algorithm = make("eskf", ImuNoise(0.01, 0.1, 1e-4, 1e-3), LAYOUT)
    whole, events, stops = through(passage_of(algorithm), measurements)
    assert stops == 2
    state, stepped, _ = through(Stepwise(algorithm), measurements)
    assert np.array_equal(whole.x, state.x)
    assert np.array_equal(whole.P, state.P)
    assert np.array_equal(whole.u, state.u)
    for a, b in zip(events, stepped, strict=True):
        assert repr(a.nis) == repr(b.nis)
        assert np.array_equal(a.innovation, b.innovation)
        assert np.array_equal(a.S, b.S)
    assert events[3].nis > 1000.0
