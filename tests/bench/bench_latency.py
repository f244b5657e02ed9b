"""From one HIGHRES_IMU datagram to its LOCAL_POSITION_NED datagram on loopback: a flight in real time, 250 Hz IMU,
all streams on, results and a recording written. `bench_latency.py [SECONDS]`, 30 unless given.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from sitl import scenario
from sitl.emitter import packets
from sitl.simulation import START_US, Simulation

HIGHRES_IMU, LOCAL_POSITION_NED = 105, 32
SETTLE_US = 5_000_000
"""The figures are of the time after this: the filter runs."""


def message_of(packet: bytes) -> int:
    """The message id of a MAVLink 2 packet."""
    return int.from_bytes(packet[7:10], "little")


def cpu_of(pid: int) -> float | None:
    """CPU seconds of a process so far, where the system tells."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def flight(seconds: float) -> Iterator[tuple[int, bytes]]:
    """The first seconds of the default scenario."""
    for t_us, packet in packets(Simulation(scenario.load("quad_mission"), 0)):
        if t_us >= START_US + seconds * 1e6:
            return
        yield t_us, packet


class Watch:
    """Notes when the sample of an instant went out and when its position came back."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.sent: dict[int, float] = {}
        self.delays: list[tuple[int, float]] = []
        self.received = 0

    def drain(self, patience: float) -> None:
        """Take what comes within `patience` s."""
        end = time.perf_counter() + patience
        while (left := end - time.perf_counter()) > 0.0:
            if not select.select([self.sock], [], [], left)[0]:
                return
            data = self.sock.recv(65535)
            now = time.perf_counter()
            self.received += 1
            if message_of(data) == LOCAL_POSITION_NED:
                # trailing zeros are cut off, but a boot time of seconds has its four bytes
                boot_ms = int.from_bytes(data[10:14], "little")
                if boot_ms in self.sent:
                    self.delays.append((boot_ms, now - self.sent.pop(boot_ms)))


def run(seconds: float) -> None:
    """Fly and print."""
    stream = list(flight(seconds))
    with tempfile.TemporaryDirectory() as folder, socket.socket(type=socket.SOCK_DGRAM) as sock:
        command = [sys.executable, "-m", "mavins", "-q", "serve", "--udp", "127.0.0.1:0"]
        command += ["--out", f"{folder}/out", "--record", f"{folder}/flight.tlog"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().rpartition(":")[2])
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
            sock.connect(("127.0.0.1", port))
            watch = Watch(sock)
            begin, cpu_at = time.perf_counter(), None
            for t_us, packet in stream:
                due = begin + (t_us - START_US) * 1e-6
                watch.drain(due - time.perf_counter())
                if cpu_at is None and t_us > START_US + SETTLE_US:
                    cpu_at = (cpu_of(process.pid), time.perf_counter())
                if message_of(packet) == HIGHRES_IMU:
                    watch.sent[t_us // 1000] = time.perf_counter()
                sock.send(packet)
            watch.drain(0.1)
            cpu, now = cpu_of(process.pid), time.perf_counter()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30.0)
    settled = (START_US + SETTLE_US) // 1000
    delays = sorted(delay for boot_ms, delay in watch.delays if boot_ms > settled)
    if not delays:
        sys.exit("no position came back")
    print(f"{len(delays)} positions in {seconds:.0f} s, {watch.received} datagrams received")
    for name, share, target in (("median", 0.5, 0.5), ("p99", 0.99, 2.0), ("largest", 1.0, None)):
        value = delays[min(len(delays) - 1, int(share * len(delays)))] * 1e3
        print(f"{name:>8} {value:7.3f} ms" + (f"   target {target} ms" if target else ""))
    if cpu is not None and cpu_at is not None and cpu_at[0] is not None:
        share = (cpu - cpu_at[0]) / (now - cpu_at[1])
        print(f"     CPU {share * 100:7.1f} % of one core   target 15 %")


if __name__ == "__main__":
    run(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0)
