"""What the tests of the whole service share: simulated streams, and a service without sockets."""

from __future__ import annotations

import itertools
import math
import re
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.config import Config
from mavins.logs.recording import Recording
from mavins.mavlink.codec import (
    Payload,
    attitude,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    system_time,
)
from mavins.mavlink.session import Session
from mavins.replay import ReplayOptions, replay
from mavins.service import Service
from mavins.types import GnssFix, ImuSample
from sitl import scenario
from sitl.emitter import packets
from sitl.simulation import START_US, Simulation

UNIX_US = 1_790_000_000_000_000
VEHICLE = (0, "127.0.0.1", 40_001)
PEER = (0, "127.0.0.1", 40_002)

Arrival = tuple[int, tuple[int, str, int], bytes]
"""Reception stamp in us, address, datagram."""


@cache
def flight(name: str, seconds: float, seed: int, sysid: int) -> tuple[tuple[int, bytes], ...]:
    """The first `seconds` of a scenario as (us since boot, packet)."""
    stream = packets(Simulation(scenario.load(name), seed), sysid)
    end_us = START_US + seconds * 1e6
    return tuple(itertools.takewhile(lambda item: item[0] < end_us, stream))


def arrivals(
    seconds: float,
    name: str = "quad_mission",
    seed: int = 0,
    sysid: int = 1,
    address: tuple[int, str, int] = VEHICLE,
) -> list[Arrival]:
    """A flight that is received without delay, one packet per datagram."""
    return [
        (UNIX_US + t_us, address, packet) for t_us, packet in flight(name, seconds, seed, sysid)
    ]


_PARSER = dialect.MAVLink(None)


def decoded(data: bytes) -> Any:
    """A packet through pymavlink."""
    return _PARSER.decode(bytearray(data))


def numbers(message: Any) -> Iterator[float]:
    """Every floating-point number of a message."""
    for name in message.get_fieldnames():
        value = getattr(message, name)
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, float):
                yield item


class Wire:
    """What the service takes for a link: it looks at every datagram that goes out."""

    is_stream = trusted = False
    peers = ()

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.dropped: Counter[str] = Counter()

    def send(self, data: bytes, address: tuple[str, int]) -> None:
        self._rig.heard(data, (0, *address))

    def close(self) -> None:
        pass


class Rig:
    """A service whose datagrams come from a list and whose clock is their stamps."""

    def __init__(self, folder: Path, config: Config | None = None) -> None:
        self.out = folder / "live"
        self.log = folder / "live.tlog"
        self.config = config or Config()
        self.service = Service(self.config, [Wire(self)], (), self.out, Recording(self.log))  # type: ignore[list-item]
        self.sent: list[tuple[int, Any, Any]] = []
        """(stamp in us, address, message) of all that went out."""
        self.tap: Callable[[bytes], None] | None = None
        self._next_tick = 0
        self._next_flush = 0
        self.now_us = UNIX_US

    @property
    def session(self) -> Session:
        return self.service.session

    def vehicle(self, sysid: int = 1) -> Any:
        return self.session.vehicles[sysid]

    def receive(self, now_us: int, address: Any, data: bytes) -> None:
        """One datagram, and the ticks that were due before it."""
        self.wait(now_us)
        self.session.receive(data, address, now_us)

    def wait(self, until_us: int) -> None:
        """Nothing comes until then."""
        if not self._next_tick:
            self._next_tick = self._next_flush = until_us
        while self._next_tick <= until_us:
            self.now_us = self._next_tick
            self.session.tick(self._next_tick)
            self._next_tick += 50_000
            self.service._write_rows()
            if self._next_flush <= self.now_us:
                self._next_flush += 1_000_000
                self.service._flush()
        self.now_us = max(self.now_us, until_us)

    def run(self, stream: Iterable[Arrival]) -> Rig:
        """All datagrams of a stream, in the order of their stamps."""
        for now_us, address, data in sorted(stream, key=lambda item: item[0]):
            self.receive(now_us, address, data)
        return self

    def heard(self, data: bytes, address: Any) -> None:
        """A datagram that the service sends."""
        message = decoded(data)
        assert all(map(math.isfinite, numbers(message))), message
        self.sent.append((self.now_us, address, message))
        if self.tap is not None:
            self.tap(data)

    def messages(self, kind: str, address: Any = None, sysid: int | None = None) -> list[Any]:
        """All messages of one kind that went to an address (None: any)."""
        return [
            message
            for _, to, message in self.sent
            if message.get_type() == kind
            and (address is None or to == address)
            and (sysid is None or message.get_srcSystem() == sysid)
        ]

    def texts(self, address: Any = VEHICLE) -> list[str]:
        """All STATUSTEXTs, put together again."""
        texts: list[str] = []
        for message in self.messages("STATUSTEXT", address):
            if message.chunk_seq:
                texts[-1] += message.text
            else:
                texts.append(message.text)
        return texts

    def close(self) -> None:
        self.service.close()

    def folder(self, sysid: int | None = None) -> Path:
        base = self.out if sysid is None else self.out / f"vehicle_{sysid}"
        return base / "eskf"

    def replayed(self, sysid: int = 1) -> Path:
        """Close, replay what was recorded, and return the result folder of the filter."""
        self.close()
        out = self.log.parent / f"replayed_{sysid}"
        replay(self.log, out, self.config, ReplayOptions(sysid=sysid))
        return out / "eskf"


class Standing:
    """The packets of a vehicle that stands still: 50 Hz IMU, 10 Hz heading, 5 Hz fixes, 1 Hz heartbeat.

    A test sets what it wants otherwise; `packets` goes on from where it was.
    """

    LAT, LON, ALT = math.radians(47.4), math.radians(8.5), 500.0

    def __init__(self, sysid: int = 1, address: Any = VEHICLE, boot_us: int = 1_000_000) -> None:
        self.sysid = sysid
        self.address = address
        self.t_us = boot_us
        self.unix_us = UNIX_US
        self.autopilot = 0
        self.lat, self.lon, self.alt = self.LAT, self.LON, self.ALT
        self.fix_type = 3
        self.fix_stamp: int | None = None
        self.yaw = 0.3
        self._seq = 0

    def packet(self, payload: Payload) -> bytes:
        """The next packet of this vehicle."""
        packet = frame(payload, self.sysid, 1, self._seq)
        self._seq = (self._seq + 1) % 256
        return packet

    def payloads(self) -> Iterator[Payload]:
        """What is due at `t_us`."""
        t_us = self.t_us
        step = t_us // 20_000
        if step % 50 == 0:
            yield heartbeat(2, self.autopilot)
            yield system_time(self.unix_us + t_us, t_us)
        yield highres_imu(ImuSample(t_us, np.array([0.0, 0.0, -9.808]), np.zeros(3)))
        if step % 5 == 0:
            yield attitude(t_us, 0.0, 0.0, self.yaw, (0.0, 0.0, 0.0))
        if step % 10 == 0:
            stamp = t_us if self.fix_stamp is None else self.fix_stamp
            v_l = (0.0, 0.0, 0.0)
            fix = GnssFix(
                stamp, self.lat, self.lon, self.alt, v_l, self.fix_type, 12, 0.5, 0.8, 0.1
            )
            yield gps_raw_int(fix)
            yield global_position_int(stamp, self.lat, self.lon, self.alt, 0.0, v_l, None)

    def packets(self, seconds: float) -> Iterator[Arrival]:
        """The next seconds, one packet per datagram."""
        for _ in range(round(seconds * 50)):
            for payload in self.payloads():
                yield self.unix_us + self.t_us, self.address, self.packet(payload)
            self.t_us += 20_000


@pytest.fixture
def standing() -> Callable[..., Standing]:
    return Standing


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path)
    yield made
    made.close()


@pytest.fixture
def make_rig(tmp_path: Path) -> Callable[..., Rig]:
    def make(config: Config | None = None, name: str = "rig") -> Rig:
        folder = tmp_path / name
        folder.mkdir()
        return Rig(folder, config)

    return make


@pytest.fixture
def fly() -> Callable[..., list[Arrival]]:
    return arrivals


@pytest.fixture
def flight_packets() -> Callable[[float], list[tuple[int, bytes]]]:
    """The first seconds of a flight as (us since boot, packet)."""
    return lambda seconds: list(flight("quad_mission", seconds, 0, 1))


START_LIMIT = 120.0
"""A cold compilation of the kernels."""


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "mavins", *words]


class Serve:
    """`mavins serve` in a process; `port` is the one it said it listens on."""

    def __init__(self, *options: str) -> None:
        self.process = subprocess.Popen(
            command("serve", "--udp", "127.0.0.1:0", *options),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []
        self._listening = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if not self._listening.wait(START_LIMIT):
            self.process.kill()
            raise AssertionError(f"serve never listened: {self.process.communicate()}")
        found = re.fullmatch(r"listening udp 127\.0\.0\.1:(\d+)", self.lines[0])
        assert found, self.lines
        self.port = int(found[1])

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip("\n"))
            self._listening.set()
        self._listening.set()

    def stop(self, number: int = signal.SIGINT) -> str:
        """End it, check the exit status, return what it said on stderr."""
        assert self.process.poll() is None, self.lines
        self.process.send_signal(number)
        assert self.process.stderr is not None
        said = self.process.stderr.read()
        assert self.process.wait(20.0) == 0, said
        self._reader.join(5.0)
        return said


@pytest.fixture
def serve() -> Iterator[Callable[..., Serve]]:
    started: list[Serve] = []

    def start(*options: str) -> Serve:
        started.append(Serve(*options))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
        one.process.wait()


@pytest.fixture
def fly_process() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    started: list[subprocess.Popen[bytes]] = []

    def start(port: int, duration: float, *options: str) -> subprocess.Popen[bytes]:
        words = ("-q", "sitl", "--udp", f"127.0.0.1:{port}", "--duration", str(duration))
        started.append(subprocess.Popen(command(*words, *options)))
        return started[-1]

    yield start
    for one in started:
        if one.poll() is None:
            one.kill()
        one.wait()
