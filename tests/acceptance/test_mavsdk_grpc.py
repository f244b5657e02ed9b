"""Programs that were written for MAVSDK 1 to 3 connect through its server, as mavsdk-grpc ships it."""

from __future__ import annotations

import importlib.util
import socket
from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.jit,
    pytest.mark.skipif(
        importlib.util.find_spec("mavsdk_grpc") is None,
        reason="client mavsdk-grpc is not installed (the extra 'acceptance')",
    ),
]


def free_tcp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
        return port


def test_the_first_position(tap: Callable[[], Any], client: Callable[..., Any]) -> None:
    line = tap()
    url = f"udpout://127.0.0.1:{line.port}"
    events = client("grpc_client.py", url, str(free_tcp_port())).events(60.0)
    place, ned = (event for event in events)
    sent = {(m.lat, m.lon) for _, m in line.from_service("GLOBAL_POSITION_INT")}
    assert (round(place["place"][0] * 1e7), round(place["place"][1] * 1e7)) in sent
    assert tuple(ned["p"]) in {(m.x, m.y, m.z) for _, m in line.from_service("LOCAL_POSITION_NED")}
    assert line.lost() == 0
