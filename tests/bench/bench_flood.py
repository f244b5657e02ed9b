"""A flood beside a flight, on loopback: what it does to the estimate's latency and to the vehicle's packets.

`bench_flood.py [RATE] [garbage|peers] [SECONDS] [udp|tcp]`: 50,000 datagrams/s of garbage unless given, in the last
two thirds of 20 s. `peers` are right heartbeats from ever other sysids. The generator is a process of its own with
eight ports; by `tcp` it has eight connections, and sends what is taken.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import multiprocessing
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from bench_latency import HIGHRES_IMU, Watch, cpu_of, flight, message_of

from mavins.mavlink.codec import frame, heartbeat
from sitl.simulation import START_US

PORTS = 8
BATCH_S = 0.001


def datagrams(kind: str) -> list[bytes]:
    """What the flood consists of."""
    if kind == "peers":
        return [frame(heartbeat(6, 8), 101 + k % 150, 190, k) for k in range(1000)]
    source = random.Random(1)
    return [source.randbytes(source.randint(9, 90)) for _ in range(1000)]


class Station(Watch):
    """Knows whether all that it sent was answered."""

    def is_answered(self, t_us: int) -> bool:
        """True once a position of the last 0.1 s before `t_us` came."""
        return bool(self.delays) and self.delays[-1][0] > t_us // 1000 - 100


def flood(
    port: int, rate: float, kind: str, by: str, seconds: float, sent: Synchronized[int]
) -> None:
    """Send at `rate` or as fast as this goes, from several ports."""
    way = socket.SOCK_STREAM if by == "tcp" else socket.SOCK_DGRAM
    sockets = [socket.socket(type=way) for _ in range(PORTS)]
    for sock in sockets:
        sock.connect(("127.0.0.1", port))
        sock.setblocking(False)
    stream = itertools.cycle(zip(itertools.cycle(sockets), datagrams(kind), strict=False))
    begin = time.perf_counter()
    count = taken = 0
    while (elapsed := time.perf_counter() - begin) < seconds:
        for sock, data in itertools.islice(stream, min(500, int(elapsed * rate) - count)):
            count += 1
            with contextlib.suppress(OSError):
                sock.send(data)
                taken += 1
        time.sleep(max(0.0, BATCH_S - (time.perf_counter() - begin - elapsed)))
    sent.value = taken


def kernel_drops(port: int) -> dict[str, int]:
    """What the kernel dropped of each socket at a port, by the other end it is bound to, if any."""
    drops: dict[str, int] = {}
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        if int(fields[1].rpartition(":")[2], 16) == port:
            mine = not fields[2].endswith(":0000")
            name = "the vehicle's socket" if mine else "the open socket"
            drops[name] = drops.get(name, 0) + int(fields[-1])
    return drops


def share(values: list[float], part: float) -> float:
    """A quantile in ms."""
    return sorted(values)[min(len(values) - 1, int(part * len(values)))] * 1e3


def run(rate: float, kind: str, seconds: float, by: str) -> None:
    """Fly, flood and print."""
    stream = list(flight(seconds))
    with tempfile.TemporaryDirectory() as folder, socket.socket(type=socket.SOCK_DGRAM) as sock:
        command = [sys.executable, "-m", "mavins", "-q", "serve", "--udp", "127.0.0.1:0"]
        command += ["--link", "tcpin://127.0.0.1:0"]
        command += ["--out", f"{folder}/out", "--record", f"{folder}/flight.tlog"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        sent = multiprocessing.Value("q", 0)
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().rpartition(":")[2])
            tcp_port = int(process.stdout.readline().rpartition(":")[2])
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
            sock.connect(("127.0.0.1", port))
            watch = Station(sock)
            flood_us = START_US + round(seconds * 1e6 / 3)
            flooding = multiprocessing.Process(
                target=flood,
                args=(
                    tcp_port if by == "tcp" else port,
                    rate,
                    kind,
                    by,
                    seconds * 2 / 3 - 0.2,
                    sent,
                ),
            )
            begin, at_start = time.perf_counter(), (0.0, 0.0)
            samples = 0
            for t_us, packet in stream:
                due = begin + (t_us - START_US) * 1e-6
                watch.drain(due - time.perf_counter())
                if not at_start[1] and t_us > flood_us:
                    at_start = cpu_of(process.pid) or 0.0, time.perf_counter()
                    flooding.start()
                if message_of(packet) == HIGHRES_IMU:
                    samples += 1
                    watch.sent[t_us // 1000] = time.perf_counter()
                sock.send(packet)
            cpu, now = cpu_of(process.pid), time.perf_counter()
            # one that was held up has yet to take what waits in its buffers
            while time.perf_counter() < now + 10.0 and not watch.is_answered(stream[-1][0]):
                watch.drain(0.2)
            drops = kernel_drops(port)
            flooding.join(5.0)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30.0)
        summary = json.loads(Path(f"{folder}/out/summary.json").read_text())
    print(
        f"{kind} by {by}: {sent.value / (seconds * 2 / 3 - 0.2):,.0f} datagrams/s of {rate:,.0f} wanted"
    )
    calm = [d for ms, d in watch.delays if flood_us - 3_000_000 < ms * 1000 < flood_us]
    flooded = [d for ms, d in watch.delays if ms * 1000 > flood_us + 500_000]
    for name, delays in (("calm", calm), ("flooded", flooded)):
        if delays:
            figures = ", ".join(f"p{p} {share(delays, p / 100):.2f} ms" for p in (50, 99, 100))
            print(f"{name:>8}: {len(delays)} positions, {figures}")
    if cpu is not None:
        print(f"     CPU: {(cpu - at_start[0]) / (now - at_start[1]) * 100:.0f} % of one core")
    print(f"     IMU: {summary['imu_samples']} samples of {samples} sent")
    print(f"  kernel: {', '.join(f'{n} dropped by {k}' for k, n in drops.items())}")
    print(f" dropped: {summary['service']['dropped']}")


if __name__ == "__main__":
    words = sys.argv[1:]
    run(
        float(words[0]) if words else 50_000.0,
        words[1] if len(words) > 1 else "garbage",
        float(words[2]) if len(words) > 2 else 20.0,
        words[3] if len(words) > 3 else "udp",
    )
