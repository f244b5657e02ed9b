"""`mavins example square-spiral` on the record, and what it says without one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mavins.cli.main import main
from mavins.filters import REGISTRY

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def test_its_figures_hold(
    shared: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = shared("data/barton").parent
    assert main(["example", "square-spiral", "--data", str(data), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "euler_ekf compat minus the original, position" in printed
    assert "FAIL" not in printed
    table = (tmp_path / "square-spiral.txt").read_text()
    assert all(name in table for name in ("original", *REGISTRY))


def test_missing_data_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example", "square-spiral", "--data", str(tmp_path)]) == 2
    assert "--data" in capsys.readouterr().err
