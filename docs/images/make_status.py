"""Draw docs/images/status.svg: the live status of a real run against the simulator.

    python docs/images/make_status.py [--seconds 45] [--scenario quad_mission]

Starts `mavins serve --status json` on a free loopback port and `mavins sitl` against it, and draws
the last status line. The picture differs a little from run to run: it shows what was there.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import time
from pathlib import Path

from mavins.cli.status import to_svg
from mavins.status import StatusSnapshot, from_json

HERE = Path(__file__).resolve().parent
MAVINS = [sys.executable, "-m", "mavins"]


def free_port() -> int:
    """A UDP port of the loopback interface that nobody uses at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def last_status(seconds: float, scenario: str) -> StatusSnapshot:
    """The status after so many seconds of flight."""
    address = f"127.0.0.1:{free_port()}"
    serve = subprocess.Popen(
        [*MAVINS, "serve", "--udp", address, "--status", "json"], stdout=subprocess.PIPE, text=True
    )
    assert serve.stdout is not None
    sitl = None
    snapshot = None
    try:
        for line in serve.stdout:
            if line.startswith("listening "):
                sitl = subprocess.Popen([*MAVINS, "sitl", "--udp", address, "--scenario", scenario])
                end = time.monotonic() + seconds
            elif line.startswith("{"):
                latest = from_json(line)
                if latest.vehicles and latest.vehicles[0].error is not None:
                    snapshot = latest
                if sitl is not None and time.monotonic() > end:
                    break
    finally:
        for process in (sitl, serve):
            if process is not None:
                process.terminate()
                process.wait()
    if snapshot is None:
        raise SystemExit("the filter never ran")
    return snapshot


def main() -> None:
    """Fly, draw, write."""
    parser = argparse.ArgumentParser(description="draw the live status of a real run")
    parser.add_argument("--seconds", type=float, default=45.0)
    parser.add_argument("--scenario", default="quad_mission")
    args = parser.parse_args()
    snapshot = last_status(args.seconds, args.scenario)
    (HERE / "status.svg").write_text(to_svg(snapshot), encoding="utf-8")


if __name__ == "__main__":
    main()
