"""`mavins demo`: the simulator flies against the service over real UDP, and the estimate is judged.

Two processes, as a user would start them: `mavins serve` prints JSON status lines, among them its
errors against the simulator's truth; they are shown live and summed up.
"""

from __future__ import annotations

import argparse
import os
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Final

from mavins.cli.status import StatusRenderer, make_renderer
from mavins.cli.verdict import Verdict
from mavins.errors import MavinsError
from mavins.status import StatusSnapshot, from_json

SUMMARY = """\
Start the service and the simulator against each other over UDP on a free loopback port, show the
live status, and end with a summary of the errors against the simulator's truth. The exit status is
1 if the filter never ran, the RMS position error is above 1 m or a process failed."""

EPILOG = """\
examples:
  mavins demo                                    30 s of the default scenario
  mavins demo --scenario figure8 --duration 120
  mavins demo --seed 7 | cat                     plain lines, one per second"""

LISTEN_LIMIT: Final = 300.0
"""Seconds until the service listens: a cold compilation of the kernels, on a slow machine too."""

START_LIMIT: Final = 90.0
"""Seconds from then on until the first estimate: the simulator's own kernels, then alignment."""

SILENCE_LIMIT: Final = 10.0
"""Seconds without a status line, once the filter runs, after which the service counts as hung."""

STOP_LIMIT: Final = 10.0
"""Seconds that a process may take to close its files after SIGTERM."""


@dataclass(frozen=True, slots=True)
class Children:
    """The commands of the two processes; a test puts its own here."""

    serve: Sequence[str]
    sitl: Sequence[str]


class DemoError(Exception):
    """A process ended or kept silent when it should not; the message is for the summary."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--duration",
        type=_seconds,
        default=30.0,
        metavar="S",
        help="seconds to run, counted from the first estimate (default 30)",
    )
    parser.add_argument(
        "--scenario",
        default="quad_mission",
        metavar="NAME",
        help="a scenario's name or YAML file (default quad_mission)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="noise seed (default 0)")


def run(args: argparse.Namespace) -> int:
    """Fly, show, judge."""
    with tempfile.TemporaryDirectory(prefix="mavins-demo-") as folder:
        children = _commands(_free_port(), folder, args.scenario, args.seed)
        mode = "off" if args.verbosity < 0 else "auto"
        return fly(children, args.duration, make_renderer(mode))


def fly(
    children: Children,
    duration: float,
    renderer: StatusRenderer,
    start_limit: float = START_LIMIT,
    stop_limit: float = STOP_LIMIT,
    listen_limit: float = LISTEN_LIMIT,
) -> int:
    """Run both processes until `duration` after the first estimate; 0 if the estimate is good."""
    verdict = Verdict()
    failures: list[str] = []
    with _termination_as_interrupt(), _Pair(stop_limit) as pair:
        try:
            _watch(pair, children, duration, (listen_limit, start_limit), renderer, verdict)
        except DemoError as error:
            failures.append(str(error))
        finally:
            renderer.close()
            failures += pair.stop()
    failures += verdict.failures()
    print(verdict.summary())
    for failure in failures:
        print(f"FAILED: {failure}")
    if not failures:
        print("PASSED")
    return 1 if failures else 0


def _watch(
    pair: _Pair,
    children: Children,
    duration: float,
    limits: tuple[float, float],
    renderer: StatusRenderer,
    verdict: Verdict,
) -> None:
    """Read the service's lines, start the simulator when it listens, end when time is up."""
    pair.start("serve", children.serve)
    listen_limit, start_limit = limits
    missing = f"not listening within {listen_limit:.0f} s"
    deadline = time.monotonic() + listen_limit
    while (left := deadline - time.monotonic()) > 0:
        patience = min(left, SILENCE_LIMIT) if verdict.samples else left
        line = pair.line(patience)
        if line is None:
            if patience < left:
                raise DemoError(f"serve said nothing for {patience:.0f} s")
            break
        if line.startswith("listening "):
            pair.start("sitl", children.sitl)
            missing = f"no estimate within {start_limit:.0f} s"
            deadline = time.monotonic() + start_limit
            continue
        snapshot = _snapshot(line)
        if snapshot is None:
            continue
        renderer.update(snapshot)
        if verdict.add(snapshot) and verdict.samples == 1:
            deadline = time.monotonic() + duration
    if not verdict.samples:
        raise DemoError(missing)


def _snapshot(line: str) -> StatusSnapshot | None:
    """The snapshot of a JSON line; whatever else the service says is passed on to stderr."""
    if line.startswith("{"):
        try:
            return from_json(line)
        except ValueError:
            pass
    print(line, file=sys.stderr)
    return None


class _Pair:
    """The two child processes: started by name, read line by line, and always ended."""

    def __init__(self, stop_limit: float) -> None:
        self._stop_limit = stop_limit
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._lines: queue.SimpleQueue[tuple[str, str | None]] = queue.SimpleQueue()

    def __enter__(self) -> _Pair:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, command: Sequence[str]) -> None:
        """Start a process in a session of its own, so that Ctrl-C reaches it through us alone."""
        if name in self._processes:
            return
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                text=True,
                errors="replace",
                start_new_session=True,
            )
        except OSError as error:
            raise MavinsError(f"{command[0]}: {error.strerror}") from None
        self._processes[name] = process
        assert process.stdout is not None
        threading.Thread(target=self._read, args=(name, process.stdout), daemon=True).start()

    def line(self, timeout: float) -> str | None:
        """The next line of the service, or None after `timeout`; DemoError if a process ends."""
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0:
            try:
                name, line = self._lines.get(timeout=left)
            except queue.Empty:
                return None
            if line is None:
                status = self._processes.pop(name).wait()
                raise DemoError(f"{name} ended by itself ({_ending(status)})")
            if name == "serve":
                return line
        return None

    def stop(self) -> list[str]:
        """End both, the simulator first, and say what went wrong. A second call does nothing."""
        failures = []
        for name in reversed(list(self._processes)):
            process = self._processes.pop(name)
            if (status := process.poll()) is not None:
                failures.append(f"{name} ended by itself ({_ending(status)})")
                continue
            process.send_signal(signal.SIGTERM)
            try:
                status = process.wait(self._stop_limit)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                failures.append(f"{name} did not end within {self._stop_limit:.0f} s of SIGTERM")
                continue
            except BaseException:  # a second Ctrl-C: no more patience
                process.kill()
                process.wait()
                raise
            if status not in (0, -signal.SIGTERM):
                failures.append(f"{name} failed ({_ending(status)})")
        return failures

    def _read(self, name: str, stream: IO[str]) -> None:
        for line in stream:
            self._lines.put((name, line.rstrip("\n")))
        self._lines.put((name, None))


def _ending(status: int) -> str:
    return f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack as Ctrl-C does, so that the children end too."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers, and only it receives signals
        return
    numbers = (signal.SIGTERM, signal.SIGHUP)
    previous = [signal.signal(number, interrupt) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, previous, strict=True):
            signal.signal(number, handler)


def _commands(port: int, folder: str, scenario: str, seed: int) -> Children:
    mavins = [sys.executable, "-m", "mavins"]
    address = f"127.0.0.1:{port}"
    out = os.path.join(folder, "out")
    return Children(
        serve=[*mavins, "serve", "--udp", address, "--status", "json", "--out", out],
        sitl=[*mavins, "sitl", "--udp", address, "--scenario", scenario, "--seed", str(seed)],
    )


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError("must be a number of seconds above 0")
    return value
