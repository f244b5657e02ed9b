"""Other settings and other filters in flight: nothing jumps, what is new is in force, and a run is repeatable."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.config import Config, load
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.fusion import Event
from mavins.estimator.history import History
from mavins.estimator.reconfigure import FIXED, applicable
from mavins.estimator.settings import Settings
from mavins.estimator.smoothing import smooth
from mavins.evaluation.consistency import errors, nees
from mavins.evaluation.errors import interpolate_truth
from mavins.evaluation.tape import Tape
from mavins.examples.scenarios import flight, matched
from mavins.filters import REGISTRY, RowBlock
from mavins.logs.truth import Truth
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import B_G
from mavins.nav.so3 import dcm_to_quat, quat_conj, quat_mul
from mavins.types import FloatArray, GnssFix, Health, Origin
from sitl.scenario import load as scenario_of

SECOND_US = 1_000_000
DURATION = 60.0
AIRBORNE_US = 12 * SECOND_US
"""After the first stamp the vehicle has taken off and the filter has settled."""
CHANGED = load(
    None,
    {
        "imu": {"rotation": [0.1, 0.0, 0.0], "delay": 0.1, "gyro_noise": 0.02},
        "gnss": {"lever_arm": [1.0, 0.0, 0.0], "delay": 0.2},
        "states": {"lever_arm": "estimate", "gnss_delay": "fixed"},
        "magnetometer": {"enabled": True, "declination_deg": 1.0, "inclination_deg": 60.0},
        "estimator": {"buffer": 3.0, "max_gap": 1.0},
        "filter": "iekf",
    },
)


def at(settings: Any, path: str) -> Any:
    return functools.reduce(getattr, path.split("."), settings)


def test_what_only_a_start_can_change_stays() -> None:
    new = applicable(Config(), CHANGED)
    for path in FIXED:
        assert at(new, path) == at(Config(), path) != at(CHANGED, path)
    assert new.imu.gyro_noise == 0.02
    assert new.gnss.delay == 0.2
    assert new.estimator.max_gap == 1.0


Change = Callable[[Estimator], None]


@functools.cache
def flown() -> tuple[Tape, Truth]:
    scenario = scenario_of("quad_mission")
    return flight(matched(Config(), scenario), scenario, 4, DURATION)


def start_us() -> int:
    return int(flown()[1].t_us[0])


@dataclasses.dataclass
class Flight:
    """A flight with changes at stamps of fixes, and all that came out of it."""

    changes: dict[int, Change]
    settings: Settings | None = None
    filter_name: str = "eskf"
    smoothed: bool = False

    def __post_init__(self) -> None:
        self.rows: list[RowBlock] = []
        self.decisions: list[tuple[int, str, str, float]] = []
        self.history = History() if self.smoothed else None
        outputs = Outputs(100_000, self._row, self._decision, self.history)
        self.estimator = Estimator(self.settings or flown()[0].settings, self.filter_name, outputs)
        due = sorted(self.changes)
        for name, what in flown()[0].feeds:
            if name == "feed_gnss":
                while due and what.t_us - start_us() >= due[0]:
                    self.changes[due.pop(0)](self.estimator)
            getattr(self.estimator, name)(what)
        self.estimator.finish()
        assert not due

    def _row(self, block: RowBlock, frame: TangentFrame) -> None:
        n = block.count
        parts = (a[:n].copy() for a in (block.t_us, block.x, block.u, block.P))
        self.rows.append(RowBlock(*parts, count=n))
        self.frame = frame

    def _decision(self, event: Event) -> None:
        m = event.measurement
        self.decisions.append((m.t_us, m.aiding, event.reason, event.nis))

    @functools.cached_property
    def table(self) -> RowBlock:
        return joined(self.rows)

    def errors(self) -> FloatArray:
        return errors(true_states(self.table, self.frame), self.table.x)


def joined(blocks: list[RowBlock]) -> RowBlock:
    parts = [np.concatenate([getattr(b, name) for b in blocks]) for name in ("t_us", "x", "u", "P")]
    return RowBlock(*parts, count=len(parts[0]))


def true_states(rows: RowBlock, frame: TangentFrame) -> FloatArray:
    lla, v_l, q_lb, _ = interpolate_truth(rows.t_us, *flown()[1].columns())
    x = rows.x.copy()
    for k in range(len(x)):
        C_ln = frame.local_level(lla[k, 0], lla[k, 1])
        x[k, 0:3] = frame.from_lla(*lla[k])
        x[k, 3:6] = C_ln.T @ v_l[k]
        x[k, 6:10] = quat_mul(quat_conj(dcm_to_quat(C_ln)), q_lb[k])
    return x


def to_filter(name: str, seen: list[tuple[Any, Any]] | None = None) -> Change:
    """Change to a filter; `seen` takes the estimates before and after."""

    def change(estimator: Estimator) -> None:
        before = estimator.solution()
        estimator.reconfigure(estimator.settings, name)
        if seen is not None:
            seen.append((before, estimator.solution()))

    return change


def tuned(**sections: dict[str, Any]) -> Change:
    """Change single settings."""

    def change(estimator: Estimator) -> None:
        settings = estimator.settings
        changed = {s: dataclasses.replace(getattr(settings, s), **v) for s, v in sections.items()}
        estimator.reconfigure(dataclasses.replace(settings, **changed))

    return change


@functools.cache
def undisturbed() -> Flight:
    return Flight({})


@pytest.mark.jit
def test_no_change_changes_no_bit() -> None:
    def same(estimator: Estimator) -> None:
        estimator.reconfigure(estimator.settings, "eskf")
        estimator.reconfigure(estimator.settings)

    changed = Flight({AIRBORNE_US + k * SECOND_US // 2: same for k in range(40)})
    assert_array_equal(changed.table.t_us, undisturbed().table.t_us)
    assert_array_equal(changed.table.x, undisturbed().table.x)
    assert_array_equal(changed.table.P, undisturbed().table.P)
    assert changed.decisions == undisturbed().decisions


@pytest.mark.jit
@pytest.mark.timeout(600)
def test_every_filter_hands_over_to_every_other() -> None:
    seen: list[tuple[Any, Any]] = []
    names = [name for pair in permutations(REGISTRY, 2) for name in pair]
    step = (round(DURATION * 1e6) - AIRBORNE_US - SECOND_US) // len(names)
    run = Flight({AIRBORNE_US + k * step: to_filter(n, seen) for k, n in enumerate(names)})
    assert len(seen) == len(names)
    for before, after in seen:
        for name in ("p_n", "v_n", "q_nb", "b_g", "b_a"):
            assert_array_equal(getattr(after, name), getattr(before, name))
        assert_allclose(after.P, before.P, rtol=1e-9, atol=1e-15)
        assert after.reset_counter == before.reset_counter == 0
    estimator = run.estimator
    assert estimator.health is Health.RUNNING
    assert (estimator.reset_counter, estimator.realignments) == (0, 0)
    assert type(estimator.filter).__name__.lower() == names[-1].replace("_", "")
    settled = run.table.t_us - start_us() > AIRBORNE_US
    e, P = run.errors()[settled], run.table.P[settled]
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    assert np.abs(e[:, :9] / sigma[:, :9]).max() < 5.0
    # nine degrees of freedom, correlated from row to row
    assert 4.0 < np.mean(nees(e, P)) < 18.0
    refused = {(aiding, reason) for _, aiding, reason, _ in run.decisions if reason}
    assert refused <= {
        ("gnss_position", "too old"),
        ("gnss_velocity", "too old"),
        ("heading", "too old"),
    }


@pytest.mark.jit
def test_a_run_with_changes_is_repeatable() -> None:
    changes = {
        AIRBORNE_US: to_filter("srcdkf"),
        AIRBORNE_US + 7 * SECOND_US: tuned(imu={"gyro_noise": 0.003}),
        AIRBORNE_US + 9 * SECOND_US: to_filter("eskf"),
    }
    first, second = Flight(changes), Flight(changes)
    assert_array_equal(first.table.x, second.table.x)
    assert_array_equal(first.table.P, second.table.P)
    assert first.decisions == second.decisions


@pytest.mark.jit
def test_what_is_changed_before_the_start_is_as_if_begun_with() -> None:
    wanted = dataclasses.replace(
        flown()[0].settings,
        heading=dataclasses.replace(flown()[0].settings.heading, sigma_deg=5.0, gate=3.0),
        imu=dataclasses.replace(flown()[0].settings.imu, gyro_noise=0.01, gyro_bias_sigma=0.02),
        alignment=dataclasses.replace(flown()[0].settings.alignment, window=0.5),
    )
    begun = Flight({}, wanted, "ieskf")
    changed = Flight({0: lambda e: e.reconfigure(wanted, "ieskf")})
    assert_array_equal(changed.table.x, begun.table.x)
    assert_array_equal(changed.table.P, begun.table.P)
    assert changed.decisions == begun.decisions


@pytest.mark.jit
def test_another_noise_is_in_force() -> None:
    at_us = AIRBORNE_US + 10 * SECOND_US
    walk = 20.0 * flown()[0].settings.imu.gyro_bias_walk + 1e-3
    run = Flight({at_us: tuned(imu={"gyro_bias_walk": walk})})
    before, usual = run.table.t_us - start_us() < at_us, undisturbed().table
    assert_array_equal(run.table.x[before], usual.x[before])
    sigma, sigma_usual = (np.sqrt(t.P[-1].diagonal()[B_G]) for t in (run.table, usual))
    assert np.all(sigma > 2.0 * sigma_usual)
    assert run.estimator.reset_counter == 0


@pytest.mark.jit
def test_a_gate_is_in_force_for_what_comes_next() -> None:
    at_us = AIRBORNE_US + 5 * SECOND_US
    run = Flight({at_us: tuned(heading={"gate": 0.01})})
    refused = [
        t for t, aiding, reason, _ in run.decisions if (aiding, reason) == ("heading", "gate")
    ]
    assert len(refused) > 1000
    assert min(refused) - start_us() >= at_us - SECOND_US
    usual = undisturbed().decisions
    assert not [1 for _, aiding, reason, _ in usual if (aiding, reason) == ("heading", "gate")]


@pytest.mark.jit
def test_a_told_delay_begins_its_estimate_anew() -> None:
    scenario = scenario_of("quad_mission")
    settings = matched(Config(), scenario)
    settings = dataclasses.replace(
        settings, states=dataclasses.replace(settings.states, gnss_delay="estimate")
    )
    estimator = Estimator(settings)
    told = False
    for name, what in flown()[0].feeds:
        if isinstance(what, GnssFix) and what.t_us - start_us() > 30 * SECOND_US:
            what = dataclasses.replace(what, delay=0.2)
            if not told:
                before = estimator.solution()
                tuned(gnss={"delay": 0.2})(estimator)
                estimator.feed_gnss(what)
                after = estimator.solution()
                assert before is not None
                assert after is not None
                assert before.sd_tau < 0.05
                # the fix itself, 0.2 s old, lies before what begins here
                assert after.tau == 0.2
                assert after.sd_tau == pytest.approx(settings.states.gnss_delay_sigma)
                assert_array_equal(after.p_n, before.p_n)
                told = True
                continue
        getattr(estimator, name)(what)
    solution = estimator.solution()
    assert told
    assert solution is not None
    # the truth is the scenario's latency, whatever was told
    assert abs(solution.tau - scenario.gnss.latency) < 4.0 * solution.sd_tau
    assert solution.sd_tau < 0.05
    assert estimator.reset_counter == 0


@pytest.mark.jit
def test_a_flight_with_another_filter_on_the_way_is_smoothed_in_pieces() -> None:
    at_us = AIRBORNE_US + 15 * SECOND_US
    run = Flight({at_us: to_filter("srcdkf")}, smoothed=True)
    assert run.history is not None
    assert len(run.history.stretches) == 2
    blocks = [block for block, _ in smooth(run.history)]
    smoothed = joined(blocks[::-1])
    assert_array_equal(smoothed.t_us, run.table.t_us)
    e = errors(true_states(smoothed, run.frame), smoothed.x)[:, :9]
    rms, before = (np.sqrt(np.mean(a[:, :6] ** 2, axis=0)) for a in (e, run.errors()))
    assert np.all(rms < before)


@pytest.mark.jit
def test_an_origin_after_a_change_is_carried_over() -> None:
    run = Flight(
        {
            AIRBORNE_US: to_filter("iekf"),
            AIRBORNE_US + SECOND_US: lambda e: e.set_origin(Origin(0.8, 0.14, 400.0)),
        }
    )
    assert run.estimator.reset_counter == 1
    assert run.estimator.health is Health.RUNNING


def test_a_tape_keeps_settings_but_not_the_filter() -> None:
    tape = Tape(Config())
    tape.reconfigure(CHANGED, "iekf")
    assert tape.settings == Config()
    assert tape.feeds == [("reconfigure", CHANGED)]
