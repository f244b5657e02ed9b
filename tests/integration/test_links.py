"""The service as a process on TCP, a serial line and several links at once: a flight whose bytes are cut anywhere."""

from __future__ import annotations

import json
import os
import random
import re
import select
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

pytestmark = [pytest.mark.slow, pytest.mark.jit]

SECONDS = 6.0
HIGHRES_IMU = 105
START_LIMIT = 280.0
"""A cold compilation on a busy machine."""


class Service:
    """`mavins serve` with any links; `lines` is what it says, `errors` what it says on stderr."""

    def __init__(self, command: list[str], links: int) -> None:
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.lines: list[str] = []
        self.errors: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=pipe, daemon=True)
            for pipe in ((self.process.stdout, self.lines), (self.process.stderr, self.errors))
        ]
        for reader in self._readers:
            reader.start()
        self.wait_for(lambda: len(self.lines) >= links, START_LIMIT)

    @staticmethod
    def _read(stream: Any, lines: list[str]) -> None:
        lines.extend(line.rstrip("\n") for line in stream)

    def wait_for(self, there: Callable[[], bool], limit: float = 20.0) -> None:
        deadline = time.monotonic() + limit
        while not there():
            assert time.monotonic() < deadline, (self.lines, self.errors)
            assert self.process.poll() is None, (self.lines, self.errors)
            time.sleep(0.02)

    def port(self, beginning: str) -> int:
        """The port of the link whose line begins so."""
        (line,) = [line for line in self.lines if line.startswith(beginning)]
        return int(re.sub(r".*:", "", line))

    def is_idle(self) -> bool:
        """True once no more packets come: what waits when it is stopped is not read."""
        counts = [json.loads(line)["packets_in"] for line in self.lines if line[:1] == "{"]
        return len(counts) > 1 and counts[-1] == counts[-2] > 0

    def stop(self) -> None:
        assert self.process.poll() is None, self.errors
        self.process.terminate()
        assert self.process.wait(20.0) == 0, self.errors
        for reader in self._readers:
            reader.join(5.0)


@pytest.fixture
def start() -> Iterator[Callable[..., Service]]:
    started: list[Service] = []

    def make(*options: str, links: int = 1) -> Service:
        started.append(Service([sys.executable, "-m", "mavins", "serve", *options], links))
        return started[-1]

    yield make
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
        one.process.wait()


@dataclass
class Listener:
    """Takes what the service sends out of a stream, and counts it by kind."""

    kinds: dict[str, int] = field(default_factory=dict)
    bad: int = 0
    numbers: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True

    def take(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(bytearray(data)) or ():
            kind = message.get_type()
            self.kinds[kind] = self.kinds.get(kind, 0) + 1
            self.bad += kind == "BAD_DATA"
            if kind != "BAD_DATA":
                self.numbers.append(message.get_seq())

    def lost(self) -> int:
        return sum((b - a) % 256 != 1 for a, b in zip(self.numbers, self.numbers[1:], strict=False))


def fly(fd: int, listener: Listener, packets: list[tuple[int, bytes]], seed: int) -> None:
    """Write packets at their times into a descriptor, in pieces cut at random; read what comes back."""
    rng = random.Random(seed)
    start_us = packets[0][0]
    started = time.monotonic()
    pending = b""
    for t_us, packet in packets:
        # what comes back is taken even where we are late: it fills a line that nobody reads
        due = started + (t_us - start_us) * 1e-6
        while select.select([fd], [], [], max(0.0, due - time.monotonic()))[0]:
            listener.take(os.read(fd, 65536))
        pending += packet
        while len(pending) > 100:
            cut = rng.randrange(1, len(pending) + 1)
            pending = pending[os.write(fd, pending[:cut]) :]
    while pending:
        pending = pending[os.write(fd, pending) :]


def judge(service: Service, listener: Listener, out: Path, sent: int) -> dict[str, Any]:
    """The flight arrived whole, and estimates came back."""
    service.wait_for(service.is_idle)
    service.stop()
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    assert summary["service"]["packets_in"] == sent
    assert summary["service"]["dropped"] == {}
    assert listener.bad == 0
    assert listener.lost() == 0
    assert listener.kinds["LOCAL_POSITION_NED"] > 50
    return summary


@pytest.fixture
def packets(flight_packets: Callable[[float], list[tuple[int, bytes]]]) -> list[tuple[int, bytes]]:
    return flight_packets(SECONDS)


def test_a_flight_over_tcp(
    start: Callable[..., Service], packets: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    service = start("--link", "tcpin://127.0.0.1:0", "--out", str(tmp_path), "--status", "json")
    port = service.port("listening tcp 127.0.0.1:")
    listener = Listener()
    with socket.create_connection(("127.0.0.1", port), 10.0) as sock:
        sock.settimeout(None)
        fly(sock.fileno(), listener, packets, 1)
        time.sleep(0.2)
        listener.take(os.read(sock.fileno(), 1 << 20))
        judge(service, listener, tmp_path, len(packets))
    assert service.errors == []


def test_a_flight_over_a_serial_line_watched_over_udp(
    start: Callable[..., Service], packets: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    pytest.importorskip("serial", reason="pyserial is not installed (mavins[serial])")
    end, line = os.openpty()
    tty.setraw(end)
    tty.setraw(line)
    device = os.ttyname(line)
    listener, watcher = Listener(), Listener()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        address = f"127.0.0.1:{station.getsockname()[1]}"
        url = f"serial://{device}?baud=921600"
        options = ("--out", str(tmp_path), "--status", "json")
        service = start("--link", url, "--gcs", address, *options, links=2)
        assert service.lines[:2] == [f"open serial {device} 921600 baud", f"sending udp {address}"]
        fly(end, listener, packets, 2)
        time.sleep(0.2)
        listener.take(os.read(end, 1 << 20))
        judge(service, listener, tmp_path, len(packets))
        while select.select([station], [], [], 0.0)[0]:
            watcher.take(station.recv(65535))
    os.close(line)
    os.close(end)
    assert watcher.kinds["LOCAL_POSITION_NED"] > 50
    assert watcher.lost() == watcher.bad == 0


def test_links_that_come_and_go_beside_one_that_stays(
    start: Callable[..., Service], packets: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    """A TCP server that appears late and vanishes, and a serial device likewise; the flight on UDP loses nothing."""
    pytest.importorskip("serial", reason="pyserial is not installed (mavins[serial])")
    device = tmp_path / "ttyTEST0"

    def plug() -> int:
        end, line = os.openpty()
        tty.setraw(end)
        device.symlink_to(os.ttyname(line))
        os.close(line)
        return end

    end = plug()
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        port = held.getsockname()[1]
        links = ("--link", f"tcp://127.0.0.1:{port}", "--link", f"serial://{device}")
        options = ("--udp", "127.0.0.1:0", "--out", str(tmp_path / "out"), "--status", "json")
        service = start(*options, *links, links=3)
        assert service.lines[1:3] == [
            f"connecting tcp 127.0.0.1:{port}",
            f"open serial {device} 57600 baud",
        ]
        listener = Listener()
        flown = threading.Event()

        def fly_udp() -> None:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
                vehicle.connect(("127.0.0.1", service.port("listening udp")))
                # UDP keeps packets whole, so they are not cut here
                started = time.monotonic()
                for t_us, packet in packets:
                    due = started + (t_us - packets[0][0]) * 1e-6
                    while select.select([vehicle], [], [], max(0.0, due - time.monotonic()))[0]:
                        listener.take(vehicle.recv(65535))
                    vehicle.send(packet)
            flown.set()

        thread = threading.Thread(target=fly_udp, daemon=True)
        thread.start()
        beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(dialect.MAVLink(None, 255))
        tcp, serial = f"tcp 127.0.0.1:{port}", f"serial {device}"
        service.wait_for(lambda: any(tcp in line for line in service.errors))
        held.listen()
        there, _ = held.accept()
        there.sendall(beat)
        service.wait_for(lambda: f"{tcp} connected" in service.errors)
        there.close()
        device.unlink()
        os.close(end)
        service.wait_for(lambda: any(f"{serial}: lost" in line for line in service.errors))
        end = plug()

        def beats_are_heard() -> bool:
            os.write(end, beat)  # what comes before the line is opened is not looked at
            return f"{serial} connected" in service.errors

        service.wait_for(beats_are_heard)
        assert flown.wait(30.0)
        thread.join()
        service.wait_for(service.is_idle)
        service.stop()
    os.close(end)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["imu_samples"] == sum(packet[7] == HIGHRES_IMU for _, packet in packets) > 1000
    assert summary["service"]["packets_in"] >= len(packets) + 2
    assert summary["service"]["dropped"]["link lost"] == 2
    assert set(summary["service"]["dropped"]) <= {"link lost", "not sent", "link congested"}
    assert listener.bad == listener.lost() == 0
    # each trouble is told of once
    assert len(service.errors) == len(set(service.errors)) == 5, service.errors
