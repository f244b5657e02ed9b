"""`mavins example no-magnetometer`: its figures hold, and it needs no data."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.config import Config
from mavins.examples.drawing import HINT
from mavins.examples.no_magnetometer import FILTERS, ROUGH, SCENARIO, SEEDS, WRONG, recorded
from mavins.examples.scenarios import matched
from sitl.scenario import parse
from sitl.simulation import START_US, simulate

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def test_figures_hold(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["example", "no-magnetometer", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "all 18 figures hold" in printed
    rows = [line for line in printed.splitlines() if line.startswith("seed ")]
    assert len(rows) == len(FILTERS) * len(SEEDS)
    pictures = {path.name for path in tmp_path.iterdir()}
    if find_spec("matplotlib") is None:
        assert HINT in printed
        assert pictures == set()
    else:
        assert pictures == {"no-magnetometer.png"}


def test_the_estimator_is_told_one_heading_and_a_worse_receiver_for_a_while() -> None:
    scenario = parse(SCENARIO)
    tape, truth = recorded(matched(Config(), scenario), scenario, seed=3)
    headings = [what for name, what in tape.feeds if name == "feed_heading"]
    assert len(headings) == 1
    assert headings[0].yaw == pytest.approx(np.radians(30.0) + WRONG, abs=0.01)
    assert headings[0].sigma == WRONG
    fixes = [what for name, what in tape.feeds if name == "feed_gnss"]
    seconds = np.array([(fix.t_us - START_US) * 1e-6 for fix in fixes])
    rough = (seconds >= ROUGH[0]) & (seconds < ROUGH[1])
    assert rough.sum() == 150
    errors = (
        np.array([fix.v_l for fix in fixes])
        - truth.v_l[np.searchsorted(truth.t_us, [f.t_us for f in fixes])]
    )
    for part, sigma in ((rough, 0.5), (~rough, 0.1)):
        assert {fix.sigma_speed for fix, inside in zip(fixes, part, strict=True) if inside} == {
            sigma
        }
        assert errors[part].std() == pytest.approx(sigma, rel=0.15)


def test_the_circles_are_flown_at_three_metres_per_second_squared() -> None:
    truth = simulate(parse(SCENARIO), 0, 60.0).truth
    acceleration = np.linalg.norm(np.gradient(truth.v_n, truth.t_us * 1e-6, axis=0), axis=1)
    late = truth.t_us > START_US + 40_000_000
    np.testing.assert_allclose(acceleration[late], 3.0, atol=0.05)
