"""Readings of a clipped accelerometer: they weigh little, however the rows come in, and in the smoother too."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimator.clipping import Clipped
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.history import History
from mavins.estimator.smoothing import smooth
from mavins.evaluation.tape import Tape
from mavins.examples.scenarios import flight, matched
from mavins.filters import REGISTRY
from mavins.types import BoolArray, FloatArray, ImuTable, IntArray, NavSolution
from sitl.scenario import load
from sitl.simulation import START_US


def test_runs_of_rows_that_are_alike() -> None:
    clipped, t_us = Clipped(), np.arange(10, 100, 10)
    assert not clipped
    assert clipped.run(t_us) == (9, False)
    clipped.mark(np.array([50, 60]))
    clipped.mark(np.array([30]))
    runs = [clipped.run(t_us[k:]) for k in range(9)]
    lengths = [2, 1, 1, 1, 2, 1, 3, 2, 1]
    assert runs == [(n, k in (2, 4, 5)) for k, n in enumerate(lengths)]
    clipped.forget_before(50)
    assert clipped.stamps().tolist() == [50, 60]
    clipped.forget_before(70)
    assert not clipped


@functools.cache
def flown() -> Tape:
    scenario = load("quad_mission")
    return flight(matched(Config(), scenario), scenario, 4, 30.0)[0]


def at_its_limit(t_us: IntArray) -> BoolArray:
    """Rows that count as clipped: three of every twenty, and all of the last half second."""
    flags: BoolArray = (t_us // 10_000 % 20 < 3) | (t_us > START_US + 29_500_000)
    return flags


def flagged(how: Callable[[IntArray], BoolArray]) -> Tape:
    """The flight with the rows marked that `how` says."""
    tape = Tape(flown().settings)
    tape.feeds = [
        (name, replace(what, clipped=how(what.t_us)) if name == "feed_imu" else what)
        for name, what in flown().feeds
    ]
    return tape


def ended(name: str, tape: Tape, rows: int = 0) -> NavSolution:
    """Where a filter ends: of a tape that is played, or of so many IMU rows at a time and each reading by itself."""
    estimator = Estimator(tape.settings, name)
    if not rows:
        tape.play(estimator)
    for feed, what in tape.feeds if rows else ():
        if feed == "feed_imu":
            for k in range(0, len(what), rows):
                estimator.feed_imu(what[k : k + rows])
        else:
            getattr(estimator, feed)(what)
    solution = estimator.solution()
    assert solution is not None
    return solution


@pytest.mark.jit
@pytest.mark.parametrize(
    "name", [n if n == "eskf" else pytest.param(n, marks=pytest.mark.slow) for n in REGISTRY]
)
def test_clipped_readings_weigh_little_however_they_come(name: str) -> None:
    plain, none = ended(name, flown()), ended(name, flagged(lambda t: np.zeros(len(t), bool)))
    np.testing.assert_array_equal(none.P, plain.P)
    tape = flagged(at_its_limit)
    clipped = ended(name, tape)
    # half a second of ten times the noise, and fixes that hold it: least so in down, where they are weakest
    wider = np.diag(clipped.P)[3:6] / np.diag(plain.P)[3:6]
    assert wider.min() > 1.05
    assert wider[2] > 3.0
    for rows in (1, 3):
        other = ended(name, tape, rows)
        np.testing.assert_array_equal(other.P, clipped.P)
        np.testing.assert_array_equal(other.p_n, clipped.p_n)
        np.testing.assert_array_equal(other.q_nb, clipped.q_nb)


@pytest.mark.jit
def test_the_smoother_goes_through_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[FloatArray] = []

    def keep(_: object, __: object, ___: object, P: FloatArray, *____: object) -> None:
        ends.append(P[-1].copy())

    monkeypatch.setattr("mavins.estimator.smoothing.smooth_back", keep)
    tape, history = flagged(at_its_limit), History()
    estimator = Estimator(tape.settings, "eskf", Outputs(100_000, None, None, history))
    tape.play(estimator)
    assert list(smooth(history))
    solution = estimator.solution()
    assert solution is not None
    np.testing.assert_array_equal(ends[0], solution.P)


def test_a_part_of_a_table() -> None:
    table = ImuTable(np.arange(4), np.zeros((4, 3)), np.ones((4, 3)))
    assert table[1:3].clipped is None
    marked = replace(table, clipped=np.array([True, False, False, True]))[2:4]
    assert marked.t_us.tolist() == [2, 3]
    assert marked.clipped is not None
    assert marked.clipped.tolist() == [False, True]
