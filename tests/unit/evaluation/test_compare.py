"""What a comparison says: time to converge, figures over several runs, the table."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.estimator.settings import Settings
from mavins.evaluation.compare import Run, converged_after, together
from mavins.evaluation.compare_table import table_lines
from mavins.evaluation.errors import Errors
from mavins.evaluation.tape import Tape
from mavins.types import FloatArray, GnssFix, HeadingFix, ImuTable, IntArray


def errors_with(north: FloatArray, yaw_deg: FloatArray) -> Errors:
    n = len(north)
    pos, att = np.zeros((n, 3)), np.zeros((n, 3))
    pos[:, 0], att[:, 2] = north, np.radians(yaw_deg)
    return Errors(np.arange(n) * 100_000, pos, np.zeros((n, 3)), att)


def test_converged_once_errors_stay_small_for_five_seconds() -> None:
    yaw = np.full(200, 1.0)
    yaw[:30], yaw[60] = 20.0, 5.0  # small for 3 s only, then for good
    assert converged_after(errors_with(np.zeros(200), yaw)) == pytest.approx(6.1)
    assert converged_after(errors_with(np.zeros(200), np.ones(200))) == 0.0


@pytest.mark.parametrize("north", [np.full(200, 3.0), np.zeros(30), np.empty(0)])
def test_never_converged(north: FloatArray) -> None:
    assert math.isnan(converged_after(errors_with(north, np.zeros(len(north)))))


def run_of(north: float, nees: FloatArray, **changes: Any) -> Run:
    n = len(nees)
    seconds: IntArray = np.arange(n) * 1_000_000
    values: dict[str, Any] = {
        "filter": "eskf",
        "t_us": seconds,
        "rows": np.zeros((n, 31)),
        "errors": errors_with(np.full(200, north), np.zeros(200)),
        "nees_us": seconds,
        "nees": nees,
        "nis": {"gnss_position": (30.0, 20)},
        "cpu_s": 0.001,
        "imu_samples": 100,
        "resets": 1,
        "health": "running",
        "reason": "",
        "fixes": (np.empty(0, dtype=np.int64), np.empty((0, 3))),
        "refused": {},
    }
    return Run(**(values | changes))


def test_figures_of_several_runs() -> None:
    figures = together([run_of(1.0, np.full(60, 8.0)), run_of(-3.0, np.full(50, 10.0))])
    assert_allclose(figures["rms"]["pos"], [math.sqrt(5.0), 0.0, 0.0])
    assert_allclose(figures["max"]["pos"], [3.0, 0.0, 0.0])
    assert figures["nees"] == pytest.approx(9.0)
    assert figures["nees_inside"] == 1.0
    assert figures["nis"] == {"gnss_position": 1.5}
    assert figures["cpu_us"] == pytest.approx(10.0)
    assert figures["resets"] == 2


def test_nees_of_the_first_half_minute_does_not_count() -> None:
    nees = np.full(60, 9.0)
    nees[:30] = 1000.0
    assert together([run_of(0.0, nees)])["nees"] == pytest.approx(9.0)


def test_a_run_without_estimates_leaves_dashes() -> None:
    empty = np.empty(0, dtype=np.int64)
    figures = together(
        [
            run_of(
                0.0,
                np.empty(0),
                errors=None,
                t_us=empty,
                nees_us=empty,
                nis={},
                health="aligning",
            )
        ]
    )
    lines = list(table_lines({"eskf": figures}))
    assert lines[1].split()[1:4] == ["-", "-", "-"]
    assert lines[-1].endswith("none; ended aligning; 1 resets")


def test_a_tape_gives_back_what_it_took() -> None:
    heard: list[tuple[str, Any]] = []

    class Ear:
        def __getattr__(self, name: str) -> Any:
            return lambda *what: heard.append((name, *what))

    tape = Tape(Settings())
    fix = GnssFix(5, 0.1, 0.2, 3.0, None, 3)
    tape.feed_gnss(fix)
    tape.restart("why")
    tape.play(Ear())  # type: ignore[arg-type]
    assert heard == [("feed_gnss", fix), ("restart", "why"), ("finish",)]


def test_a_tape_plays_samples_and_what_lies_between_together() -> None:
    tape = Tape(Settings())
    heard: list[tuple[Any, ...]] = []

    class Ear:
        def __getattr__(self, name: str) -> Any:
            return lambda *what: heard.append((name, *what))

        def feed_run(self, table: ImuTable, between: list[Any]) -> None:
            heard.append(("run", table.t_us.tolist(), list(between)))

    a, b, c = (HeadingFix(k, 0.0) for k in range(3))
    one, two = (ImuTable(np.arange(k), np.zeros((k, 3)), np.zeros((k, 3))) for k in (1, 2))
    tape.feed_heading(a)
    tape.feed_run(two, [(0, b), (1, c)])
    tape.feed_imu(one)
    tape.restart("why")
    tape.feed_imu(one)
    tape.play(Ear())  # type: ignore[arg-type]
    assert heard == [
        ("feed_heading", a),
        ("feed_heading", b),
        ("run", [0, 1, 0], [(1, c)]),
        ("restart", "why"),
        ("run", [0], []),
        ("finish",),
    ]


def test_fixes_of_a_tape() -> None:
    tape = Tape(Settings())
    tape.feed_gnss(GnssFix(5, 0.1, 0.2, 3.0, None, 3))
    t_us, places = tape.fixes()
    assert t_us.tolist() == [5]
    assert_allclose(places, [[0.1, 0.2, 3.0]])
