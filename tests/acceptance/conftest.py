"""What the tests with real clients share: one service with a vehicle that flies, and taps that hear what is said."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import pytest
from pymavlink.dialects.v20 import all as dialect

START_LIMIT = 120.0
"""A cold compilation of the kernels."""
SYSID = 100
"""Under which the service speaks of vehicle 1."""
CLIENTS = Path(__file__).parent / "clients"


def mavins(*words: str) -> list[str]:
    return [sys.executable, "-m", "mavins", *words]


class Text:
    """What a process prints, collected while it runs."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._changed = threading.Condition()
        self._text = ""
        self._ended = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self._stream:
            with self._changed:
                self._text += line
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def __str__(self) -> str:
        with self._changed:
            return self._text

    def find(self, pattern: str, limit: float, start: int = 0) -> re.Match[str]:
        """The first match after `start` within `limit` seconds; fails without one."""
        compiled = re.compile(pattern)
        end = time.monotonic() + limit
        with self._changed:
            while True:
                found = compiled.search(self._text, start)
                if found:
                    return found
                left = end - time.monotonic()
                if left <= 0.0 or self._ended:
                    pytest.fail(f"no '{pattern}' within {limit} s:\n{self._text[-3000:]}")
                self._changed.wait(left)


def end(process: subprocess.Popen[str], limit: float = 20.0) -> None:
    """End a process, the hard way if it must be."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(limit)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@dataclass(frozen=True)
class Flight:
    """A service at `port` and a simulated vehicle that flies on."""

    port: int
    status: Text


@pytest.fixture(scope="package")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """One service and one vehicle for all clients; the filter runs."""
    folder = tmp_path_factory.mktemp("flight")
    service = subprocess.Popen(
        mavins("serve", "--udp", "127.0.0.1:0", "--status", "json"),
        stdout=subprocess.PIPE,
        stderr=(folder / "complaints.txt").open("w"),
        text=True,
        cwd=folder,
    )
    assert service.stdout is not None
    status = Text(service.stdout)
    simulator: subprocess.Popen[str] | None = None
    try:
        port = int(status.find(r"listening udp 127\.0\.0\.1:(\d+)", START_LIMIT)[1])
        simulator = subprocess.Popen(
            mavins("-q", "sitl", "--udp", f"127.0.0.1:{port}"),
            stdout=subprocess.DEVNULL,
            text=True,
            cwd=folder,
        )
        status.find(r'"health": ?"running"', 60.0)
        yield Flight(port, status)
        assert service.poll() is None, str(status)[-2000:]
    finally:
        if simulator is not None:
            end(simulator)
        end(service)
    assert service.returncode == 0, (folder / "complaints.txt").read_text()


Heard = tuple[float, Any]
"""When, and the message through pymavlink."""


class Tap:
    """Stands between one client and the service, and keeps every datagram that passes with its time."""

    def __init__(self, service_port: int) -> None:
        self._client: Any = None
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", 0))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for one in (self._front, self._back):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._back.connect(("127.0.0.1", service_port))
        self.port: int = self._front.getsockname()[1]
        self.asked: list[tuple[float, bytes]] = []
        self.answered: list[tuple[float, bytes]] = []
        self._open = True
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def _relay(self) -> None:
        while self._open:
            for one in select.select([self._front, self._back], [], [], 0.1)[0]:
                data, address = one.recvfrom(65535)
                if one is self._front:
                    self._client = address
                    self.asked.append((time.monotonic(), data))
                    self._back.send(data)
                elif self._client is not None:
                    self.answered.append((time.monotonic(), data))
                    self._front.sendto(data, self._client)

    def close(self) -> None:
        self._open = False
        self._thread.join()
        self._front.close()
        self._back.close()

    @staticmethod
    def _messages(datagrams: list[tuple[float, bytes]]) -> list[Heard]:
        parser = dialect.MAVLink(None)
        return [
            (t, message)
            for t, data in list(datagrams)
            for message in parser.parse_buffer(bytearray(data)) or ()
        ]

    def from_client(self, kind: str | None = None) -> list[Heard]:
        """What the client sent, all of it or one kind."""
        return [h for h in self._messages(self.asked) if kind in (None, h[1].get_type())]

    def from_service(self, kind: str | None = None) -> list[Heard]:
        """What the service sent to this client, all of it or one kind."""
        return [h for h in self._messages(self.answered) if kind in (None, h[1].get_type())]

    def wait_until(self, true: Callable[[Tap], bool], limit: float = 8.0) -> None:
        """Wait until something holds of what has passed."""
        end = time.monotonic() + limit
        while not true(self):
            assert time.monotonic() < end, self.from_client()[-5:]
            time.sleep(0.1)

    def lost(self) -> int:
        """How many packets of the service are missing by their sequence numbers."""
        # in the bytes, because pymavlink gives messages that its dialect lacks the number 0
        numbers = [message.get_msgbuf()[4] for _, message in self.from_service()]
        return sum((b - a - 1) % 256 for a, b in itertools.pairwise(numbers))

    def not_taken(self) -> int:
        """How many datagrams the client left in its socket until the kernel threw them away."""
        table = Path("/proc/net/udp")
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        rows = [line.split() for line in lines]
        mine = f":{self._client[1]:04X}"
        return sum(int(row[-1]) for row in rows if row[1].endswith(mine))

    def unanswered(self) -> Counter[str]:
        """Answers that the service owes yet."""
        asked = (ANSWERS.get(message.get_type()) for _, message in self.from_client())
        given = Counter(message.get_type() for _, message in self.from_service())
        return Counter(kind for kind in asked if kind is not None) - given

    def requests(self) -> Counter[tuple[Any, ...]]:
        """How often the client asked for the same thing."""
        return Counter(
            key for _, message in self.from_client() if (key := request_key(message)) is not None
        )


ANSWERS = {
    "COMMAND_LONG": "COMMAND_ACK",
    "COMMAND_INT": "COMMAND_ACK",
    "FILE_TRANSFER_PROTOCOL": "FILE_TRANSFER_PROTOCOL",
    "MISSION_REQUEST_LIST": "MISSION_COUNT",
    "PING": "PING",
}
"""Request -> what answers each of them."""
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_LISTS = ("PARAM_REQUEST_LIST", "MISSION_REQUEST_LIST", "AUTOPILOT_VERSION_REQUEST")


def request_key(message: Any) -> tuple[Any, ...] | None:
    """What a request asks for, so that the same asked twice has one key; None for what needs no answer."""
    kind = message.get_type()
    if kind in _COMMANDS:
        return kind, message.command, message.param1, message.target_component
    if kind in _LISTS:
        return kind, message.target_component, getattr(message, "mission_type", 0)
    if kind == "PARAM_REQUEST_READ":
        return kind, message.param_id, message.param_index
    if kind == "FILE_TRANSFER_PROTOCOL":
        data = bytes(message.payload)
        return kind, data[3], data[8 : 12 + data[4]]
    return None


@pytest.fixture
def tap(flight: Flight) -> Iterator[Callable[[], Tap]]:
    """Makes taps; a client connects to the `port` of one."""
    made: list[Tap] = []

    def make() -> Tap:
        made.append(Tap(flight.port))
        return made[-1]

    yield make
    for one in made:
        one.close()


class Client:
    """A client program that says what it sees, an object of JSON per line."""

    def __init__(self, script: str, *words: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(CLIENTS / script), *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def events(self, limit: float) -> list[dict[str, Any]]:
        """Wait for its end, which must be a good one; all that it said."""
        said, complaint = self.process.communicate(timeout=limit)
        assert self.process.returncode == 0, said[-2000:] + complaint[-2000:]
        return [json.loads(line) for line in said.splitlines() if line.startswith("{")]


@pytest.fixture
def client() -> Iterator[Callable[..., Client]]:
    started: list[Client] = []

    def start(script: str, *words: str) -> Client:
        started.append(Client(script, *words))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
            one.process.communicate()


class Console:
    """MAVProxy in a folder of its own, with its prompt on a pipe."""

    def __init__(self, port: int, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-m", "MAVProxy.mavproxy", f"--master=udpout:127.0.0.1:{port}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=folder,
            env={**os.environ, "HOME": str(folder)},
        )
        assert self.process.stdout is not None
        self.text = Text(self.process.stdout)

    def type(self, line: str) -> int:
        """Enter a command; returns where in the text its answer begins."""
        assert self.process.stdin is not None
        at = len(str(self.text))
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return at

    def ask(self, line: str, pattern: str, limit: float = 8.0) -> re.Match[str]:
        """Enter a command and wait for what it should bring."""
        return self.text.find(pattern, limit, self.type(line))

    def close(self) -> str:
        """End of input, which ends it; all that it printed."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        return str(self.text)


@pytest.fixture
def mavproxy(tmp_path: Path) -> Iterator[Callable[[int], Console]]:
    for module in ("MAVProxy", "pynmeagps", "defusedxml", "lxml", "serial"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(
                f"client MAVProxy is not installed ({module} is absent): "
                "pip install --no-deps MAVProxy, and the extra 'acceptance'"
            )
    started: list[Console] = []

    def start(port: int) -> Console:
        started.append(Console(port, tmp_path / "mavproxy"))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
            one.process.wait()
