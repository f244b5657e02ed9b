"""`mavins example lever-and-delay` on the record, its seeds and the recorded flight: its figures hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mavins.cli.main import main

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def test_its_figures_hold(
    shared: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pygeomag")
    shared("recordings/ap_copter_square_circle.tlog.xz")
    data = shared("data/psins").parent
    status = main(["example", "lever-and-delay", "--data", str(data), "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert status == 0, printed
    assert "all 13 figures hold" in printed
    table = (tmp_path / "lever-and-delay.txt").read_text()
    assert all(name in table for name in ("153", "186", "193, position only", "20 simulated seeds"))


def test_missing_data_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example", "lever-and-delay", "--data", str(tmp_path)]) == 2
    assert "--data" in capsys.readouterr().err
