"""A series of simulated flights: the same bytes whoever flies them, and figures that are those of the runs."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from mavins.campaign.montecarlo import (
    QUANTITIES,
    Flown,
    Series,
    figures_of,
    fly,
    jobs_of,
    montecarlo,
    sizes_of,
)
from mavins.campaign.series_files import pace_line, table_lines
from mavins.campaign.vary import Spread
from mavins.campaign.workers import Workers
from mavins.cli.main import main
from mavins.config import Config
from mavins.errors import ConfigError
from mavins.evaluation.errors import Errors
from mavins.examples.scenarios import matched
from sitl.gnss import ReportedSettings
from sitl.scenario import load

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

DURATION = 40.0
VARY = """\
scenario.gnss.sigma_h: {loguniform: [0.2, 2.0]}
config.heading.sigma_deg: {choice: [1, 4]}
"""
SAME = ("montecarlo.json", "runs.csv")


def series(**changes: object) -> Series:
    scenario = load("quad_mission")
    values = Series(scenario, matched(Config(), scenario), ("eskf",), 3, DURATION, 5)
    return dataclasses.replace(values, **changes)  # type: ignore[arg-type]


def test_the_same_bytes_from_one_worker_and_from_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vary = tmp_path / "vary.yaml"
    vary.write_text(VARY)
    for jobs in ("1", "2"):
        command = ["montecarlo", "quad_mission", "--runs", "4", "--duration", str(DURATION)]
        more = ["--vary", str(vary), "--jobs", jobs, "--out", str(tmp_path / jobs)]
        assert main([*command, *more]) == 0
        assert "4 runs in" in capsys.readouterr().out
    for name in SAME:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()
    with (tmp_path / "1" / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == ["0", "1", "2", "3"]
    sigmas = [float(row["scenario.gnss.sigma_h"]) for row in rows]
    assert len(set(sigmas)) == 4
    assert all(0.2 <= sigma <= 2.0 for sigma in sigmas)
    told = json.loads((tmp_path / "1" / "montecarlo.json").read_text())
    assert told["vary"]["config.heading.sigma_deg"] == {"choice": [1, 4]}
    median = np.median([float(row["rms_horizontal_m"]) for row in rows])
    figures = told["filters"]["eskf"]
    assert figures["rms_of_runs"]["horizontal_m"]["50"] == pytest.approx(median, rel=1e-5)


def test_a_run_does_not_depend_on_the_others() -> None:
    long = montecarlo(series(runs=3), Workers(1))
    late = montecarlo(series(runs=1, seed=7), Workers(1))
    assert long[2].seed == late[0].seed == 7
    assert long[2].sizes.tobytes() == late[0].sizes.tobytes()
    assert long[2].nees.tobytes() == late[0].nees.tobytes()
    assert long[1].sizes.tobytes() != long[2].sizes.tobytes()


def test_filters_get_the_same_flight() -> None:
    both = fly(jobs_of(series(runs=1, filters=("eskf", "iekf")))[0])
    assert [one.filter for one in both] == ["eskf", "iekf"]
    assert abs(both[0].rms - both[1].rms).max() < 0.1
    assert both[0].sizes.tobytes() != both[1].sizes.tobytes()


def test_a_wrong_noise_shows_in_nis_and_nees() -> None:
    scenario = load("quad_mission")
    honest = figures_of(montecarlo(series(), Workers(2)))
    gnss = dataclasses.replace(
        scenario.gnss, sigma_h=1.0, sigma_v=1.6, reported=ReportedSettings(0.5, 0.8, 0.1)
    )
    noisy = dataclasses.replace(scenario, gnss=gnss)
    fooled = figures_of(montecarlo(series(scenario=noisy), Workers(2)))
    low, high = honest["nis"]["gnss_position"]["band"]
    assert 0.8 < low < 1.0 < high < 1.2
    assert honest["nis"]["gnss_position"]["mean"] < 1.2
    assert 3.0 < fooled["nis"]["gnss_position"]["mean"] < 5.0
    assert fooled["nees"] > 1.3 * honest["nees"]


def test_sizes() -> None:
    errors = Errors(
        np.array([0]),
        np.array([[3.0, 4.0, -2.0]]),
        np.array([[2.0, 3.0, 6.0]]),
        np.radians([[0.3, -0.4, -5.0]]),
    )
    assert sizes_of(errors)[0] == pytest.approx([5.0, 2.0, 7.0, 0.5, 5.0])


def flown(run: int, rms: float, **changes: object) -> Flown:
    seconds = np.arange(60) * 1_000_000
    sizes = np.full((60, len(QUANTITIES)), rms)
    sizes[:30] = 1e3  # has not settled
    values = Flown(
        run,
        run,
        {},
        "eskf",
        seconds,
        sizes,
        sizes[-1],
        sizes[-1],
        seconds,
        np.full(60, 9.0),
        {"heading": (30.0, 20)},
        {("heading", "gate"): 1},
        1.0,
        "running",
        "",
        0,
        0.5,
        2.0,
    )
    return dataclasses.replace(values, **changes)  # type: ignore[arg-type]


def test_figures_of_runs() -> None:
    lost = flown(
        3,
        math.nan,
        t_us=np.empty(0, np.int64),
        sizes=np.empty((0, 5)),
        converged_s=math.nan,
        health="waiting",
        nis={},
    )
    figures = figures_of([flown(0, 1.0), flown(1, 2.0), flown(2, 3.0), lost])
    assert figures["percentiles"]["yaw_deg"]["50"] == 2.0
    assert figures["rms_of_runs"]["horizontal_m"]["50"] == 2.0
    assert figures["largest"]["vertical_m"] == 3.0
    assert figures["health"] == {"running": 3, "waiting": 1}
    assert figures["never_converged"] == 1
    assert figures["convergence_s"]["95"] == 1.0
    assert figures["refused"] == {"heading": {"gate": 4}}
    assert figures["nis"]["heading"]["mean"] == 1.5
    assert figures["nis"]["heading"]["rows"] == 60
    assert figures["nees"] == 9.0
    assert figures["nees_inside"] == 1.0
    text = "\n".join(table_lines({"eskf": figures}))
    assert "1 ended waiting" in text
    assert "4 heading refused (gate)" in text
    assert "CPU per run: simulation 0.50 s, eskf 2.00 s" in pace_line([flown(0, 1.0)], 3.0)


def test_not_one_run_with_an_estimate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["montecarlo", "quad_mission", "--runs", "1", "--duration", "0.5", "--jobs", "1"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    assert "1 never converged" in capsys.readouterr().out
    told = json.loads((tmp_path / "montecarlo.json").read_text())
    assert told["filters"]["eskf"]["percentiles"]["yaw_deg"]["95"] is None


def test_what_cannot_be_drawn_is_said_before_anything_flies() -> None:
    spread = Spread("scenario.gnss.sigma_h", "normal", (-5.0, 0.1))
    with pytest.raises(ConfigError, match=r"--vary drew scenario\.gnss\.sigma_h = -"):
        jobs_of(series(spreads=(spread,)))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--runs", "0"], "--runs 0"),
        (["--seed", "-1"], "--seed -1"),
        (["--duration", "nan"], "--duration nan"),
        (["--jobs", "0"], "--jobs 0"),
        (["--filters", "x"], "unknown filter 'x'"),
    ],
)
def test_options_that_make_no_sense(
    tmp_path: Path, option: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["montecarlo", "quad_mission", "--out", str(tmp_path), *option]) == 2
    assert message in capsys.readouterr().err


def test_the_figure(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from mavins.campaign.series_plot import draw_series

    drawn = {"scenario.gnss.sigma_h": 0.5, "config.filter": "eskf"}
    runs = {"eskf": [flown(k, 1.0 + k, drawn=drawn) for k in range(3)]}
    for name in ("a.png", "b.png"):
        draw_series(tmp_path / name, runs)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
