"""`mavins example`: exit status and messages, with examples made up here."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mavins.cli import example
from mavins.cli.main import main
from mavins.examples import REGISTRY
from mavins.examples.base import Figure, needed


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = ModuleType("made_up")
    monkeypatch.setitem(sys.modules, "made_up", module)
    monkeypatch.setitem(REGISTRY, "made-up", ("made_up", "an example of the tests"))
    return module


@pytest.mark.parametrize(
    ("value", "status", "word"),
    [(0.5, 0, "all 1 figures hold"), (1.5, 1, "fail: error"), (math.nan, 1, "fail: error")],
)
def test_exit_status_tells_whether_the_figures_hold(
    made_up: ModuleType,
    capsys: pytest.CaptureFixture[str],
    value: float,
    status: int,
    word: str,
) -> None:
    made_up.run = lambda data, out, say: [Figure("error", value, 1.0, "m")]
    assert main(["example", "made-up"]) == status
    assert word in capsys.readouterr().out


def test_missing_data_are_one_line(
    made_up: ModuleType, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    made_up.run = lambda data, out, say: [needed(data, "barton")]
    assert main(["example", "made-up", "--data", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert str(tmp_path / "barton") in error
    assert len(error.splitlines()) == 1


def test_where_data_are_looked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MAVINS_DATA", raising=False)
    assert example.data_folder(None) is None
    monkeypatch.setenv("MAVINS_DATA", "/elsewhere")
    assert example.data_folder(None) == Path("/elsewhere")
    assert example.data_folder(tmp_path) == tmp_path
