"""`mavins status` and `mavins serve` as a user has them: two processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mavins.status import from_json

pytestmark = pytest.mark.jit


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as made:
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", made)
        yield Path(made) / "mavins"


def status(*options: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "mavins", "status", *options]
    return subprocess.run(words, capture_output=True, text=True, timeout=60.0, check=False)


def test_a_running_service_answers_and_an_ended_one_does_not(
    serve: Callable[..., Any], runtime: Path
) -> None:
    first, second = (serve("--status", "off") for _ in range(2))
    pids = (str(first.process.pid), str(second.process.pid))
    for pid in pids:
        snapshot = from_json(status("--json", "--pid", pid).stdout)
        assert (str(snapshot.pid), snapshot.vehicles) == (pid, ())
    assert {path.stem for path in runtime.iterdir()} == set(pids)
    assert "waiting for a vehicle's IMU" in status("--pid", pids[0]).stdout

    first.stop()
    assert {path.stem for path in runtime.iterdir()} == {pids[1]}
    gone = status("--pid", pids[0])
    assert (gone.returncode, gone.stdout) == (2, "")
    assert gone.stderr.count("\n") == 1

    os.kill(second.process.pid, signal.SIGSTOP)
    hangs = status("--pid", pids[1])
    os.kill(second.process.pid, signal.SIGCONT)
    assert hangs.returncode == 2
    assert "does not answer" in hangs.stderr
    assert status("--pid", pids[1]).returncode == 0
    second.stop()
