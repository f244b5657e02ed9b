"""`mavins compare` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mavins.cli.main import main
from mavins.filters import REGISTRY

pytestmark = [pytest.mark.slow, pytest.mark.jit]


# where no filter is compiled yet, all of them are here
@pytest.mark.timeout(900)
def test_every_filter_on_a_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["compare", "hover", "--seeds", "2", "--duration", "60", "--out", str(tmp_path)]
    assert main(command) == 0
    shown = capsys.readouterr().out
    found = json.loads((tmp_path / "compare.json").read_text())
    assert set(found["filters"]) == set(REGISTRY)
    for name, figures in found["filters"].items():
        assert name in shown
        assert set(figures["rms"]) == set(figures["max"]) == {"pos", "vel", "att"}
        assert max(figures["rms"]["pos"]) < 1.0
        assert figures["nees"] < 30.0
        assert figures["cpu_us"] > 0.0
        assert figures["health"] == ["running", "running"]
    assert (tmp_path / "compare.png").stat().st_size > 10_000


def test_a_log_that_a_simulator_wrote(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    sitl = ["sitl", "--record", str(log), "--duration", "25", "--speed", "max"]
    assert main(["-q", *sitl, "--scenario", "hover"]) == 0
    assert main(["-q", "compare", str(log), "--filters", "eskf", "--out", str(tmp_path)]) == 0
    figures = json.loads((tmp_path / "compare.json").read_text())["filters"]["eskf"]
    assert main(["-q", "replay", str(log), "--filter", "eskf", "--out", str(tmp_path / "re")]) == 0
    truth = json.loads((tmp_path / "re" / "summary.json").read_text())["truth"]
    assert figures["rms"]["pos"] == pytest.approx(truth["rms"]["pos_m"], rel=1e-9)
    assert figures["rms"]["att"] == pytest.approx(truth["rms"]["att_deg"], rel=1e-9)


def test_what_is_unknown_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for source, filters, word in (
        ("nowhere", "all", "nowhere"),
        ("hover", "eskf,kalmann", "kalmann"),
    ):
        command = ["compare", source, "--filters", filters, "--out", str(tmp_path)]
        assert main(command) == 2
        error = capsys.readouterr().err
        assert word in error
        assert len(error.splitlines()) == 1
