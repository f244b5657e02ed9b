"""The demo's frame with fake processes: it judges, it reports, and it leaves no process behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from mavins.cli import demo
from mavins.cli.status import make_renderer
from mavins.status import EstimateStatus, StatusSnapshot, TruthError, VehicleStatus, to_json

ESTIMATE = EstimateStatus(47.0, 8.0, 400.0, *[(0.0, 0.0, 0.0)] * 6)


def line(health: str, error: float | None) -> str:
    truth = None if error is None else TruthError((error, 0.0, 0.0), (0.0, 0.1, 0.0), (0, 0, 0.01))
    estimate = ESTIMATE if health == "running" else None
    vehicle = VehicleStatus(1, health, "", 0, estimate, {"imu": 250.0}, {}, 0, truth)
    return to_json(StatusSnapshot(1.0, 1, 10, 10, {}, (vehicle,)))


SERVE = """
import signal, sys, time
from pathlib import Path
Path({pid!r}).write_text(str(__import__("os").getpid()))
signal.signal(signal.SIGTERM, {on_term})
print("compiling", flush=True)
print("listening udp 127.0.0.1:14550", flush=True)
while not Path({sitl!r}).exists():
    time.sleep(0.01)
print({waiting!r}, flush=True)
for _ in range({count}):
    print({running!r}, flush=True)
    time.sleep(0.02)
{after}
"""
SITL = """
import os, time
from pathlib import Path
Path({pid!r}).write_text(str(os.getpid()))
{after}
"""
FOREVER = "while True: time.sleep(0.05)"


class Pair:
    """Fake service and simulator, with the places where they leave their process ids."""

    def __init__(self, folder: Path) -> None:
        self.serve_pid, self.sitl_pid = folder / "serve.pid", folder / "sitl.pid"

    def children(
        self,
        error: float | None = 0.1,
        health: str = "running",
        count: int = 10**6,
        on_term: str = "lambda *_: sys.exit(0)",
        serve_after: str = FOREVER,
        sitl_after: str = FOREVER,
    ) -> demo.Children:
        serve = SERVE.format(
            pid=str(self.serve_pid),
            sitl=str(self.sitl_pid),
            waiting=line("waiting", None),
            running=line(health, error),
            count=count,
            on_term=on_term,
            after=serve_after,
        )
        sitl = SITL.format(pid=str(self.sitl_pid), after=sitl_after)
        return demo.Children([sys.executable, "-c", serve], [sys.executable, "-c", sitl])

    def alive(self) -> list[Path]:
        return [path for path in (self.serve_pid, self.sitl_pid) if _is_alive(path)]


def _is_alive(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        os.kill(int(path.read_text()), 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    return Pair(tmp_path)


def fly(children: demo.Children, **limits: float) -> int:
    bounds = {"duration": 0.3, "start_limit": 20.0, "stop_limit": 5.0} | limits
    return demo.fly(children, renderer=make_renderer("off"), **bounds)


def test_a_good_flight_passes(pair: Pair, capsys: pytest.CaptureFixture[str]) -> None:
    assert fly(pair.children()) == 0
    out = capsys.readouterr()
    assert "RMS error: position 0.100 m, velocity 0.100 m/s, attitude 0.573 deg" in out.out
    assert out.out.endswith("PASSED\n")
    assert "compiling" in out.err
    assert pair.alive() == []


@pytest.mark.parametrize(
    ("children", "duration", "complaint"),
    [
        ({"error": 1.5}, 0.3, "RMS position error 1.50 m is above 1 m"),
        ({"error": None}, 0.3, "the simulator's truth was never seen"),
        ({"sitl_after": "raise SystemExit(3)"}, 30.0, "sitl ended by itself (exit status 3)"),
        ({"count": 3, "serve_after": "sys.exit(2)"}, 30.0, "serve ended by itself (exit status 2)"),
        ({"on_term": "lambda *_: sys.exit(9)"}, 0.3, "serve failed (exit status 9)"),
    ],
)
def test_a_bad_flight_fails_and_says_why(
    pair: Pair,
    capsys: pytest.CaptureFixture[str],
    children: dict[str, object],
    duration: float,
    complaint: str,
) -> None:
    assert fly(pair.children(**children), duration=duration) == 1  # type: ignore[arg-type]
    assert f"FAILED: {complaint}" in capsys.readouterr().out
    assert pair.alive() == []


def test_a_filter_that_never_runs_fails(pair: Pair, capsys: pytest.CaptureFixture[str]) -> None:
    assert fly(pair.children(health="aligning"), start_limit=1.0) == 1
    assert "FAILED: no estimate within 1 s" in capsys.readouterr().out
    assert pair.alive() == []


def test_a_service_that_never_listens_fails(pair: Pair, capsys: pytest.CaptureFixture[str]) -> None:
    children = demo.Children([sys.executable, "-c", "import time; time.sleep(60)"], ["true"])
    assert fly(children, listen_limit=1.0) == 1
    assert "FAILED: not listening within 1 s" in capsys.readouterr().out


def test_a_service_that_falls_silent_fails(
    pair: Pair, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "SILENCE_LIMIT", 0.3)
    assert fly(pair.children(count=3), duration=30.0) == 1
    assert "FAILED: serve said nothing" in capsys.readouterr().out


def test_a_process_that_will_not_end_is_killed(
    pair: Pair, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fly(pair.children(on_term="signal.SIG_IGN"), stop_limit=0.3) == 1
    assert "serve did not end within" in capsys.readouterr().out
    assert pair.alive() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_both_processes(pair: Pair, number: signal.Signals) -> None:
    def interrupt() -> None:
        while not pair.sitl_pid.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        fly(pair.children(), duration=30.0)
    assert pair.alive() == []


def test_the_commands_are_those_a_user_would_type() -> None:
    children = demo._commands(14551, "/tmp/x", "hover", 7)
    assert " ".join(children.serve[1:]) == (
        "-m mavins serve --udp 127.0.0.1:14551 --status json --out /tmp/x/out"
    )
    assert " ".join(children.sitl[1:]) == (
        "-m mavins sitl --udp 127.0.0.1:14551 --scenario hover --seed 7"
    )


@pytest.mark.parametrize("duration", ["0", "-1", "nan", "inf", "soon"])
def test_a_duration_must_be_a_time(duration: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mavins", "demo", "--duration", duration],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "--duration" in done.stderr
