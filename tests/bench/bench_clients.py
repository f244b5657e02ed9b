"""Ten ground stations on one service at the default rates: its share of a core, packets that a station misses, and the
time of a parameter list. `bench_clients.py [SECONDS [STATIONS]]`, 20 and 10 unless given.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from pymavlink.dialects.v20 import all as dialect

SETTLE_S = 12.0
"""From the simulator's start until the filter runs and the machine is calm."""
HEARTBEAT_S = 1.0
PARAM_VALUE = 22
SYSID = 100


def message_of(packet: bytes) -> int:
    """The message id of a MAVLink 2 packet."""
    return int.from_bytes(packet[7:10], "little")


def cpu_of(pid: int) -> float:
    """CPU seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Station:
    """A ground station: heartbeats, and a count of what is missing by the sequence numbers."""

    def __init__(self, service: tuple[str, int]) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.sock.connect(service)
        self._link = dialect.MAVLink(None, 255, 190)
        self._last: int | None = None
        self.received = self.lost = 0

    def send(self, message: dialect.MAVLink_message) -> None:
        self.sock.send(message.pack(self._link))

    def hello(self) -> None:
        self.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def take(self) -> bytes:
        packet = self.sock.recv(65535)
        if self._last is not None:
            self.lost += (packet[4] - self._last - 1) % 256
        self._last = packet[4]
        self.received += 1
        return packet

    def not_taken(self) -> int:
        """Packets that the kernel threw away because this program was late."""
        port = f":{self.sock.getsockname()[1]:04X}"
        lines = Path("/proc/net/udp").read_text().splitlines()[1:]
        return sum(int(row[-1]) for line in lines if (row := line.split())[1].endswith(port))


def listen(stations: list[Station], seconds: float) -> None:
    """All stations read, and say that they are there once a second."""
    by_sock = {station.sock: station for station in stations}
    end = time.perf_counter() + seconds
    next_hello = 0.0
    while (now := time.perf_counter()) < end:
        if now >= next_hello:
            next_hello = now + HEARTBEAT_S
            for station in stations:
                station.hello()
        for sock in select.select(list(by_sock), [], [], min(end, next_hello) - now)[0]:
            by_sock[sock].take()


def parameter_list(station: Station) -> tuple[int, float]:
    """How many parameters a list holds, and how long it takes until all have come."""
    began = time.perf_counter()
    station.send(dialect.MAVLink_param_request_list_message(SYSID, 1))
    seen: set[int] = set()
    count = -1
    while len(seen) != count and time.perf_counter() - began < 20.0:
        packet = station.take()
        if message_of(packet) == PARAM_VALUE:
            # param_value, param_count, param_index
            body = packet[10 : 10 + packet[1]].ljust(25, b"\0")
            count = int.from_bytes(body[4:6], "little")
            seen.add(int.from_bytes(body[6:8], "little"))
    return len(seen), time.perf_counter() - began


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    number = int(sys.argv[2]) if len(sys.argv) > 2 else 10
    mavins = [sys.executable, "-m", "mavins"]
    service = subprocess.Popen(
        [*mavins, "serve", "--udp", "127.0.0.1:0", "--status", "off"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert service.stdout is not None
    port = int(service.stdout.readline().rpartition(":")[2])
    simulator = subprocess.Popen([*mavins, "-q", "sitl", "--udp", f"127.0.0.1:{port}"])
    stations = [Station(("127.0.0.1", port)) for _ in range(number)]
    try:
        listen(stations, SETTLE_S)
        for station in stations:
            station.received = station.lost = 0
        late_before = sum(station.not_taken() for station in stations)
        cpu, wall = cpu_of(service.pid), time.perf_counter()
        listen(stations, seconds)
        cpu, wall = cpu_of(service.pid) - cpu, time.perf_counter() - wall
        late = sum(station.not_taken() for station in stations) - late_before
        count, took = parameter_list(stations[0])
    finally:
        for process in (simulator, service):
            process.send_signal(signal.SIGINT)
            process.wait(20.0)
    packets = sum(station.received for station in stations)
    lost = [station.lost for station in stations]
    print(f"{'ground stations':<42}{number:10d}")
    print(f"{'packets to each':<42}{packets / number / wall:10.0f} /s")
    print(f"{'CPU of the service':<42}{100.0 * cpu / wall:10.1f} % of one core")
    print(f"{'packets that a station misses, the worst':<42}{max(lost):10d}")
    print(f"{'  of all, left in the sockets of this bench':<42}{late:9d}")
    print(f"{'parameters in a list':<42}{count:10d}")
    print(f"{'time of the list':<42}{took:10.2f} s")


if __name__ == "__main__":
    main()
