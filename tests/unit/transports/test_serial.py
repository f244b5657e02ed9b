"""A serial line over a pseudo-terminal: raw bytes both ways, and a device that vanishes and comes back."""

from __future__ import annotations

import os
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mavins.errors import TransportError
from mavins.transports.base import Link
from mavins.transports.serial import LEAST_QUEUE_BYTES, SerialTransport
from mavins.transports.stream import CONGESTED, FIRST_WAIT_S, LOST, NOT_SENT

pytest.importorskip("serial", reason="pyserial is not installed (mavins[serial])")

LIMIT_S = 10.0


class Cable:
    """A device that can be unplugged: a link in a folder to a pseudo-terminal, whose other end is ours."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.end = -1

    def plug(self) -> None:
        self.end, line = os.openpty()
        tty.setraw(self.end)
        self.device.symlink_to(os.ttyname(line))
        os.set_blocking(self.end, False)
        os.close(line)

    def unplug(self) -> None:
        if self.end >= 0:
            self.device.unlink()
            os.close(self.end)
            self.end = -1


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    made = Cable(tmp_path / "ttyTEST0")
    made.plug()
    yield made
    made.unplug()


def pieces(link: Link, until: Callable[[list[Any]], bool]) -> list[Any]:
    got: list[Any] = []
    deadline = time.monotonic() + LIMIT_S
    while not until(got):
        assert time.monotonic() < deadline, got
        got += link.recv(0.02)
    return got


def test_every_byte_both_ways(cable: Cable) -> None:
    line: Link = SerialTransport(str(cable.device), 921600, print)
    assert line.announcement == f"open serial {cable.device} 921600 baud"
    assert (line.is_stream, line.trusted) == (True, False)
    assert line.peers == (line.address,) == ((str(cable.device), 0),)
    every = bytes(range(256))
    os.write(cable.end, every)
    got = pieces(line, lambda got: sum(len(data) for data, _ in got) == 256)
    assert b"".join(data for data, _ in got) == every
    assert {address for _, address in got} == {line.address}
    line.send(every, line.address)
    back = b""
    deadline = time.monotonic() + LIMIT_S
    while len(back) < 256 and time.monotonic() < deadline:
        line.recv(0.0)
        try:
            back += os.read(cable.end, 1000)
        except BlockingIOError:
            time.sleep(0.005)
    assert back == every
    line.close()
    line.close()
    assert line.recv(0.0) == []


def test_it_is_raw_and_has_the_asked_speed(cable: Cable) -> None:
    line = SerialTransport(str(cable.device), 115200, print)
    (connection,) = line._connections.values()
    iflag, oflag, cflag, lflag, ispeed, ospeed, _ = termios.tcgetattr(connection.fd)
    assert (ispeed, ospeed) == (termios.B115200, termios.B115200)
    assert not lflag & (termios.ECHO | termios.ICANON | termios.ISIG)
    assert not oflag & termios.OPOST
    assert not iflag & (termios.ICRNL | termios.IXON)
    assert cflag & termios.CS8 == termios.CS8
    line.close()


def test_a_device_that_vanishes_and_comes_back(cable: Cable) -> None:
    told: list[str] = []
    now = [50.0]
    line = SerialTransport(str(cable.device), 57600, told.append, clock=lambda: now[0])
    os.write(cable.end, b"before")
    assert pieces(line, lambda got: got != [])[0][0] == b"before"
    cable.unplug()
    assert pieces(line, lambda got: got != []) == [(b"", line.address)]
    assert not line.is_open
    assert line.dropped == {LOST: 1}
    line.send(b"x", line.address)
    assert line.dropped[NOT_SENT] == 1
    for _ in range(5):  # it is tried, and told of once
        now[0] += 10.0
        line.tick()
    assert len(told) == 1
    assert told[0].startswith(f"serial {cable.device}: lost, ")
    assert "\n" not in told[0]
    cable.plug()
    line.tick()
    assert not line.is_open  # not before its time
    now[0] += 10.0
    line.tick()
    assert line.is_open
    os.write(cable.end, b"after")
    assert pieces(line, lambda got: got != [])[0][0] == b"after"
    assert told[1:] == [f"serial {cable.device} connected"]
    # the next loss is waited for shortly again
    cable.unplug()
    pieces(line, lambda got: got != [])
    assert line._next_attempt == now[0] + FIRST_WAIT_S
    line.close()


def test_a_line_that_takes_nothing_keeps_nobody_waiting(cable: Cable) -> None:
    line = SerialTransport(str(cable.device), 9600, print)
    for k in range(2000):
        line.send(bytes([k % 256]) * 100, line.address)
    assert line.dropped[CONGESTED] > 0
    (connection,) = line._connections.values()
    assert connection._size <= LEAST_QUEUE_BYTES
    got = b""
    deadline = time.monotonic() + LIMIT_S
    while connection.is_waiting and time.monotonic() < deadline:
        try:
            got += os.read(cable.end, 100_000)
        except BlockingIOError:
            time.sleep(0.005)
        line.recv(0.0)
    # closing does not wait either, with bytes that nobody has read
    line.send(b"last", line.address)
    line.close()
    while True:
        try:
            got += os.read(cable.end, 100_000)
        except OSError:
            break
    whole = got[: len(got) // 100 * 100]
    assert all(len(set(whole[k : k + 100])) == 1 for k in range(0, len(whole), 100))


def test_the_line_is_ours_alone(cable: Cable) -> None:
    line = SerialTransport(str(cable.device), 57600, print)
    with pytest.raises(TransportError, match="in use by another program"):
        SerialTransport(str(cable.device), 57600, print)
    line.close()
    SerialTransport(str(cable.device), 57600, print, trusted=True).close()


def test_what_cannot_be_opened(tmp_path: Path) -> None:
    missing = tmp_path / "ttyNONE"
    with pytest.raises(TransportError, match=r"ttyNONE: no such device") as caught:
        SerialTransport(str(missing), 57600, print)
    assert "\n" not in str(caught.value)
    missing.write_text("")
    with pytest.raises(TransportError, match="not a serial line"):
        SerialTransport(str(missing), 57600, print)


def test_without_pyserial_the_way_to_it_is_named(
    cable: Cable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(TransportError, match=r"pip install 'mavins\[serial\]'"):
        SerialTransport(str(cable.device), 57600, print)
