"""`mavins example foot-mounted` on the real walks: its figures hold, and its table is complete."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from mavins.cli.main import main
from mavins.examples.drawing import HINT

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def test_figures_hold(
    shared: Callable[[str], Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data = shared("data/zupt").parent
    assert main(["example", "foot-mounted", "--data", str(data), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "all 2 figures hold" in printed
    names = [line.split()[0] for line in printed.splitlines() if line.split()[1:]]
    assert sum(name.startswith("loop_") for name in names) == 5
    assert sum(name.startswith("201") for name in names) == 11
    pictures = {path.name for path in tmp_path.iterdir()}
    if find_spec("matplotlib") is None:
        assert HINT in printed
        assert pictures == set()
    else:
        assert pictures == {"openshoe.png", "vicon.png"}
