"""`mavins example flights`, and the same flights by `mavins replay` with the default settings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from mavins.cli.main import main
from mavins.filters import REGISTRY

pytest.importorskip("pygeomag")
pytestmark = [pytest.mark.slow, pytest.mark.jit]

FOLDERS = ("fixedwing_umn_thor75", "quad_apm_122a")
FLIGHTS = (*FOLDERS, "quad_px4_mr_tropic.ulg.xz")


def test_every_filter_flies_all_flights(
    shared: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = shared("data/flights").parent
    status = main(["example", "flights", "--data", str(data), "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert status == 0, said
    tables = json.loads((tmp_path / "flights.json").read_text())
    assert tuple(tables) == FLIGHTS
    for flight in FLIGHTS:
        assert list(tables[flight]) == list(REGISTRY)
        assert all(table["instants"] > 500 for table in tables[flight].values())
    assert set(tables["quad_apm_122a"]["eskf"]["rms"]) == {"att_deg"}


@pytest.mark.parametrize("flight", FOLDERS)
def test_a_flight_needs_no_settings(
    shared: Callable[[str], Path], tmp_path: Path, flight: str
) -> None:
    folder = shared(f"data/flights/{flight}")
    assert main(["-q", "replay", str(folder), "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["health"] == "running"
    assert (summary["resets"], summary["realignments"]) == (0, 0)
    roll, pitch, _ = summary["reference"]["rms"]["att_deg"]
    assert max(roll, pitch) < 2.0


def test_missing_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example", "flights", "--data", str(tmp_path)]) == 2
    assert "fixedwing_umn_thor75" in capsys.readouterr().err
