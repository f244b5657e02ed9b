"""MAVProxy, driven by its prompt: alone, and beside MAVSDK on the same service."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from typing import Any

import pytest

from mavins.parameters import TABLE

pytestmark = [pytest.mark.slow, pytest.mark.jit]

PARAMETER = "GNSS_GATE"
ALL = len(TABLE)
START = 20.0


def start(mavproxy: Callable[[int], Any], port: int) -> Any:
    """MAVProxy with a vehicle on its link and its parameters received."""
    console = mavproxy(port)
    console.text.find(r"Detected vehicle 100:1", START)
    console.text.find(rf"Received {ALL} parameters", START)
    return console


def shown(console: Any) -> float:
    return float(console.ask(f"param show {PARAMETER}", rf"{PARAMETER}\s+(-?[\d.]+)")[1])


def told(line: Any) -> float:
    """The newest value that the service told."""
    found = [m.param_value for _, m in line.from_service("PARAM_VALUE") if m.param_id == PARAMETER]
    return float(found[-1])


def goes_well(console: Any, line: Any) -> None:
    """What is asked of a session with MAVProxy, whatever else was done in it."""
    state = console.ask("link", r"link 1 OK \((\d+) packets.*?(\d+) lost, ([\d.]+)% loss")
    # a machine with too much to do lets it be late; what it was too late for is not lost on the way
    late = line.not_taken()
    assert line.lost() == 0
    assert int(state[1]) > 100  # it asks for 4 Hz of each stream
    assert int(state[2]) <= late
    assert late or float(state[3]) == 0.0
    text = str(console.text)
    console.close()
    assert "breach" not in text.lower()
    assert not re.search(r"(?i:timed? ?out|retry|no heartbeat|bad data)|Traceback", text), text


def test_a_session(tap: Callable[[], Any], mavproxy: Callable[[int], Any]) -> None:
    line = tap()
    console = start(mavproxy, line.port)
    asked, _ = line.from_client("PARAM_REQUEST_LIST")[0]
    received = [t for t, m in line.from_service("PARAM_VALUE")]
    assert len(received) >= ALL
    # it waits for eleven seconds where a file transfer is not refused
    assert received[ALL - 1] - asked < 5.0

    usual = shown(console)
    for wanted in (0.5 * usual, usual):
        console.type(f"param set {PARAMETER} {wanted}")
        line.wait_until(lambda tap, wanted=wanted: told(tap) == wanted)
        read = console.ask(f"param fetch {PARAMETER}", rf"{PARAMETER} = (-?[\d.]+)")
        assert float(read[1]) == pytest.approx(wanted, rel=1e-5)
    assert shown(console) == pytest.approx(usual, rel=1e-5)
    place = console.ask(
        "status LOCAL_POSITION_NED", r"LOCAL_POSITION_NED {[^}]*?, x : (-?[\d.e-]+)"
    )
    assert float(place[1]) in {m.x for _, m in line.from_service("LOCAL_POSITION_NED")}
    goes_well(console, line)
    line.wait_until(lambda tap: not tap.unanswered())
    # it asks eleven times for a file that nobody refuses
    assert {key: n for key, n in line.requests().items() if n > 10} == {}


@pytest.mark.skipif(
    importlib.util.find_spec("mavsdk") is None,
    reason="client mavsdk is not installed (the extra 'acceptance')",
)
def test_both_at_the_same_time(
    tap: Callable[[], Any], mavproxy: Callable[[int], Any], client: Callable[..., Any]
) -> None:
    first, second = tap(), tap()
    console = start(mavproxy, first.port)
    url = f"udpout://127.0.0.1:{second.port}"
    other = client("mavsdk_client.py", url, "parameters", PARAMETER)
    events = other.events(60.0)
    (listed,) = (e["value"] for e in events if e["kind"] == "all")
    (whole,) = (e["value"] for e in events if e["kind"] == "whole")
    assert len(listed["float_params"]) == ALL
    # what the one has set the other shows, and both read the same number from it
    assert shown(console) == pytest.approx(whole, rel=1e-5)
    seen = [m.param_value for _, m in first.from_service("PARAM_VALUE") if m.param_id == PARAMETER]
    assert pytest.approx(0.5 * whole) in seen
    goes_well(console, first)
    assert second.lost() == 0
