"""A simulated autopilot that sends no IMU until it is asked, or refuses to, and a service beside it."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from sitl import scenario

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def scenario_file(folder: Path, **keys: Any) -> str:
    """quad_mission with IMU off at the start, and other keys."""
    data = yaml.safe_load((scenario._FOLDER / "quad_mission.yaml").read_text())
    path = folder / "mission.yaml"
    path.write_text(yaml.safe_dump({**data, "streams": {"highres_imu": 0}, **keys}))
    return str(path)


def snapshots(service: Any) -> list[dict[str, Any]]:
    return [json.loads(line) for line in service.lines[1:] if line.startswith("{")]


def wait_for(service: Any, found: Callable[[dict[str, Any]], bool], limit: float) -> dict[str, Any]:
    end = time.monotonic() + limit
    while time.monotonic() < end:
        last = next((s for s in snapshots(service) if found(s)), None)
        if last is not None:
            return last
        time.sleep(0.2)
    raise AssertionError(service.lines[-3:])


def running(snapshot: dict[str, Any]) -> bool:
    return any(v["health"] == "running" for v in snapshot["vehicles"])


def test_an_autopilot_that_waits_to_be_asked(
    serve: Callable[..., Any],
    fly_process: Callable[..., subprocess.Popen[bytes]],
    tmp_path: Path,
) -> None:
    service = serve("--status", "json", "--out", str(tmp_path / "out"))
    fly_process(service.port, 60.0, "--scenario", scenario_file(tmp_path))
    last = wait_for(service, running, 40.0)
    (vehicle,) = last["vehicles"]
    wait_for(service, lambda s: s["vehicles"] and s["vehicles"][0]["rates"]["HIGHRES_IMU"] > 180, 9)
    assert last["remarks"] == []
    assert 0.0 < vehicle["round_trip"] < 0.5
    service.stop()
    asked = json.loads((tmp_path / "out/summary.json").read_text())["asking"]
    assert asked["messages"]["HIGHRES_IMU"]["state"] == "coming"
    assert asked["remarks"] == []


@pytest.mark.parametrize(
    ("commands", "text"),
    [
        ("deny", "denies HIGHRES_IMU: none comes"),
        ("ignore", "does not answer SET_MESSAGE_INTERVAL"),
    ],
)
def test_one_that_refuses_is_told_of_within_ten_seconds(
    serve: Callable[..., Any],
    fly_process: Callable[..., subprocess.Popen[bytes]],
    tmp_path: Path,
    commands: str,
    text: str,
) -> None:
    service = serve("--status", "json")
    name = scenario_file(tmp_path, commands=commands)
    fly_process(service.port, 60.0, "--scenario", name)
    heard = wait_for(service, lambda s: s["packets_in"] > 0, 40.0)
    last = wait_for(service, lambda s: bool(s["remarks"]), 20.0)
    assert last["uptime"] - heard["uptime"] <= 10.0
    assert text in last["remarks"][0]
    assert last["vehicles"] == []
    service.stop()
