"""A decoder that nobody here has written reads every message that we can stream, and reads the same in it."""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.streams import MSGIDS

pytestmark = [pytest.mark.slow, pytest.mark.jit]

SCRIPT = Path(__file__).parent / "clients" / "read_packets.js"
INTERVAL_US = 100_000.0
CAPTURED_S = 6.0
SET_MESSAGE_INTERVAL = 511
OF_THE_SERVICE = frozenset(("HEARTBEAT", "GPS_RAW_INT", "COMMAND_ACK"))
"""What comes without being asked for by an interval."""


@pytest.fixture
def node() -> str:
    program = shutil.which("node")
    if program is None:
        pytest.skip("client node-mavlink needs Node.js, which is not installed")
    look = subprocess.run([program, "-e", "require('node-mavlink')"], capture_output=True)
    if look.returncode != 0:
        pytest.skip(
            "client node-mavlink is not installed: npm install node-mavlink, "
            "and NODE_PATH names its node_modules"
        )
    return program


def capture(port: int) -> bytes:
    """All streams turned on by a peer, and the raw packets as it receives them."""
    link = dialect.MAVLink(None, 255, 190)
    packets = bytearray()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        sock.connect(("127.0.0.1", port))
        sock.settimeout(10.0)
        sock.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(link))
        for msgid in MSGIDS:
            command = dialect.MAVLink_command_long_message(
                100, 1, SET_MESSAGE_INTERVAL, 0, msgid, INTERVAL_US, 0, 0, 0, 0, 0
            )
            sock.send(command.pack(link))
        end = time.monotonic() + CAPTURED_S
        while time.monotonic() < end:
            packets += sock.recv(65535)
    return bytes(packets)


def camel(name: str) -> str:
    """A field's name as JavaScript has it."""
    return re.sub(r"_(\w)", lambda m: m[1].upper(), name)


def number(value: Any) -> float:
    return float(value.replace("Infinity", "inf")) if isinstance(value, str) else float(value)


def same(ours: Any, theirs: Any) -> bool:
    """Two readings of a field: a list, a text, or a number that may be none."""
    if isinstance(ours, (list, tuple)):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(ours, (str, bytes)):
        text = ours.decode() if isinstance(ours, bytes) else ours
        return text.rstrip("\0") == str(theirs).rstrip("\0")
    other = number(theirs)
    return other == ours or (math.isnan(other) and math.isnan(ours))


def test_every_stream(flight: Any, node: str, tmp_path: Path) -> None:
    packets = capture(flight.port)
    file = tmp_path / "packets.bin"
    file.write_bytes(packets)
    done = subprocess.run(
        [node, str(SCRIPT), str(file)], capture_output=True, text=True, timeout=60.0
    )
    assert done.returncode == 0, done.stderr[-3000:]
    *theirs, counts = map(json.loads, done.stdout.splitlines())
    assert counts == {"valid": len(theirs), "invalid": 0, "unknown": 0}
    ours = dialect.MAVLink(None).parse_buffer(bytearray(packets))
    assert ours is not None
    assert len(ours) == len(theirs)
    for message, other in zip(ours, theirs, strict=True):
        assert message.get_type() == other["name"], other
        assert (message.get_srcSystem(), message.get_srcComponent()) == (100, 1)
        for field in message.get_fieldnames():
            assert same(getattr(message, field), other["values"][camel(field)]), (field, other)
    names = [other["name"] for other in theirs]
    for name in MSGIDS.values():
        assert names.count(name.upper()) > 0.5 * CAPTURED_S * 1e6 / INTERVAL_US, name
    assert set(names) >= OF_THE_SERVICE
    numbers = [other["seq"] for other in theirs]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))
