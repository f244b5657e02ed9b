"""`mavins observe` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.config import Config
from mavins.estimator.estimator import Estimator, Outputs
from mavins.evaluation.observability import analyse, prior_sigmas
from mavins.examples.scenarios import course, flight, matched
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import Layout
from sitl.scenario import load

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def observed(out: Path, *arguments: str) -> dict[str, Any]:
    assert main(["observe", *arguments, "--out", str(out)]) == 0
    found: dict[str, Any] = json.loads((out / "observability.json").read_text())
    return found


def ratios(found: dict[str, Any]) -> dict[str, float]:
    return {state["name"]: state["final_ratio"] for state in found["states"]}


def test_a_scenario_with_and_without_heading(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = ["hover", "--duration", "30"]
    found = observed(tmp_path / "with", *scenario)
    shown = capsys.readouterr().out
    assert "theta_b.z" in shown
    assert "at rest" in shown
    assert len(found["segments"]) == 3
    assert (tmp_path / "with" / "observability.png").stat().st_size > 10_000
    blind = observed(tmp_path / "without", *scenario, "--without", "heading")
    assert ratios(found)["theta_b.z"] < 0.1
    assert ratios(blind)["theta_b.z"] > 0.9
    core = observed(tmp_path / "core", *scenario, "--states", "core")
    assert len(core["states"]) == 15


def test_a_log(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    sitl = ["sitl", "--record", str(log), "--duration", "40", "--speed", "max"]
    assert main(["-q", *sitl, "--scenario", "quad_mission"]) == 0
    found = observed(tmp_path, str(log))
    assert found["segments"][0]["measurements"] > 100
    # it accelerates and turns: of the lever arm the horizontal part shows
    assert ratios(found)["l_b.x"] < 0.5
    short = observed(tmp_path / "short", str(log), "--duration", "8")
    assert len(short["segments"]) == 1
    assert ratios(short)["l_b.x"] > 0.9


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["nowhere"], "nowhere"),
        (["hover", "--without", "compass"], "compass"),
        (["hover", "--window", "0"], "--window"),
        (["hover", "--duration", "nan"], "--duration"),
    ],
)
def test_what_makes_no_sense_is_one_line(
    arguments: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["observe", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert len(error.splitlines()) == 1


def test_the_filter_sees_what_the_analysis_promises() -> None:
    """On a flight with good gyros process noise hardly matters: the sigmas are halved at the same instants."""
    config, scenario = Config(), load("quad_mission")
    settings = matched(config, scenario)
    analysis = analyse(
        course(settings, scenario, 40.0), Layout.of(), prior_sigmas(settings), window=10.0
    )
    times, sigmas = [], []

    def take(block: RowBlock, _: TangentFrame) -> None:
        times.append(block.t_us[: block.count].copy())
        sigmas.append(np.sqrt(np.diagonal(block.P[: block.count], axis1=1, axis2=2)))

    tape, _ = flight(settings, scenario, 0, 40.0)
    tape.play(Estimator(settings, "eskf", Outputs(200_000, take)))
    t_us, sigma = np.concatenate(times), np.concatenate(sigmas)
    for state in ("b_a.x", "b_a.y", "b_a.z"):
        i = analysis.states.index(state)
        halved = t_us[np.flatnonzero(sigma[:, i] < 0.5 * analysis.prior[i])[0]]
        assert abs(halved - analysis.visible_us[i]) < 2_000_000
