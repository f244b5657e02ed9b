"""The page on Python: its examples run as they stand, one after the other."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = [pytest.mark.jit, pytest.mark.slow]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "api.md"


def test_the_examples_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.chdir(tmp_path)
    sitl = [sys.executable, "-m", "sitl", "--record", "flight.tlog", "--duration", "15"]
    subprocess.run([*sitl, "--speed", "max"], check=True)
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) == 4
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert (tmp_path / "flight.png").stat().st_size > 10_000
    text = capsys.readouterr().out
    assert "iekf running" in text
    assert "RMS, m:" in text


def test_the_table_names_what_there_is() -> None:
    import mavins

    text = PAGE.read_text(encoding="utf-8").split("## Result")[1].split("```")[0]
    cells = re.findall(r"^\| (`[^|]*) \|", text, re.MULTILINE)
    named = {name.partition("(")[0] for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    there = {name for name in dir(mavins.Result) if not name.startswith("_")}
    assert named == there - {"plot", "against"}
