"""The start of `mavins serve`: time to `listening` with a warm kernel cache, CPU with a cold one, and memory."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time

from sitl import scenario
from sitl.emitter import packets
from sitl.simulation import START_US, Simulation

ROUNDS = 3
FLIGHT_S = 10.0


def start(cache: str | None, fly: bool = False) -> tuple[float, float, float, int]:
    """(s to `listening`, CPU s in all, peak memory in MiB, lines of progress) of one run."""
    environment = dict(os.environ) if cache is None else {**os.environ, "MAVINS_CACHE": cache}
    begin = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "mavins", "serve", "--udp", "127.0.0.1:0", "--status", "off"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    port = int(process.stdout.readline().rpartition(":")[2])
    wall = time.monotonic() - begin
    if fly:
        fly_fast(port)
    process.send_signal(signal.SIGINT)
    lines = len(process.stderr.read().splitlines())
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    memory = usage.ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)
    return wall, usage.ru_utime + usage.ru_stime, memory, lines


def fly_fast(port: int) -> None:
    """A flight at five times its pace."""
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        begin = time.monotonic()
        for t_us, packet in packets(Simulation(scenario.load("quad_mission"), 0)):
            seconds = (t_us - START_US) * 1e-6
            if seconds > FLIGHT_S:
                return
            time.sleep(max(0.0, begin + seconds / 5.0 - time.monotonic()))
            sock.send(packet)


def run() -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as cache:
        wall, cpu, memory, lines = start(cache)
        print(f"cold: {cpu:.1f} s CPU ({wall:.1f} s), {lines} lines of progress   target 40 s CPU")
        print(f"      {memory:.0f} MiB at most")
        rounds = [start(cache) for _ in range(ROUNDS)]
        best = min(rounds)
        shown = ", ".join(f"{one[0]:.2f}" for one in rounds)
        print(f"warm: {best[0]:.2f} s to 'listening' (rounds {shown})   target 2 s")
        memory = start(cache, fly=True)[2]
        print(f"      {memory:.0f} MiB at most, with {FLIGHT_S:.0f} s of flight   target 250 MiB")


if __name__ == "__main__":
    run()
