"""What `serve --record` writes, read by pymavlink's tools: every packet, none damaged, none missing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavins.logs.tlog import read_tlog

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def tool(name: str, *words: str) -> str:
    """What a tool of pymavlink's says of logs."""
    script = Path(sys.executable).parent / name
    if not script.exists():
        pytest.skip(f"{name} is not installed beside this Python")
    done = subprocess.run(
        [sys.executable, str(script), *words],
        env={**os.environ, "MAVLINK20": "1", "MAVLINK_DIALECT": "all"},
        capture_output=True,
        text=True,
        timeout=120.0,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def read_by_mavlogdump(log: Path) -> int:
    """How many messages are in a log, none of them damaged."""
    lines = tool("mavlogdump.py", "--dialect", "all", str(log)).splitlines()
    lines = [line for line in lines if re.match(r"\d{4}-\d\d-\d\d ", line)]
    assert not [line for line in lines if "BAD_DATA" in line or "UNKNOWN" in line]
    return len(lines)


def complete_by_mavloss(log: Path) -> None:
    """No packet of any source is missing."""
    said = tool("mavloss.py", "--dialect", "all", str(log))
    total = re.search(r"Total: (\d+) packets, (\d+) lost 0\.0%", said)
    assert total, said
    assert int(total[1]) > 100
    assert total[2] == "0", said
    assert "attributed" not in said


def test_a_recording_is_read_without_an_error(
    serve: Callable[..., Any],
    fly_process: Callable[..., subprocess.Popen[bytes]],
    tmp_path: Path,
) -> None:
    log = tmp_path / "flight.tlog"
    service = serve("--record", str(log), "--status", "off")
    assert fly_process(service.port, 8.0).wait(60.0) == 0
    service.stop()
    frames = read_tlog(log)
    assert not frames.damage
    assert {1, 100} <= set(frames.sysid.tolist())
    assert read_by_mavlogdump(log) == len(frames)
    complete_by_mavloss(log)
    # a torn tail, as after a power cut, costs the last packet alone
    log.write_bytes(log.read_bytes()[:-7])
    assert read_by_mavlogdump(log) == len(frames) - 1
    complete_by_mavloss(log)
