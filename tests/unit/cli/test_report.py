"""`mavins report`, and the report that `mavins replay` writes or says how to get."""

from __future__ import annotations

import builtins
import sys
from pathlib import Path
from typing import Any

import pytest

import mavins.report
from mavins.cli import replay
from mavins.cli.main import main
from mavins.estimates import Result


def missing(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """An installation without a package."""
    whole = builtins.__import__

    def without(module: str, *args: Any, **named: Any) -> Any:
        if module.partition(".")[0] == name:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return whole(module, *args, **named)

    for module in list(sys.modules):
        if module.partition(".")[0] == name or module == "mavins.report.page":
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(builtins, "__import__", without)


def test_it_is_written_where_the_results_are(
    clean: Result,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("plotly")
    monkeypatch.setattr(mavins.report, "read_result", lambda folder: clean)
    assert main(["report", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"written to {tmp_path / 'report.html'}\n"
    assert (tmp_path / "report.html").stat().st_size > 4e6
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_what_is_no_result_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("plotly")
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_the_extra_the_command_is_named(
    clean: Result,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(mavins.report, "read_result", lambda folder: clean)
    missing(monkeypatch, "plotly")
    assert main(["report", str(tmp_path)]) == 2
    assert "pip install 'mavins[report]'" in capsys.readouterr().err
    replay._report(tmp_path, clean, tmp_path)  # a replay goes on
    said = capsys.readouterr().err
    assert "pip install 'mavins[report]'" in said
    assert f"mavins report {tmp_path}" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "report.html").exists()
