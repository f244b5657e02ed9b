"""A multicast group on loopback: everyone hears everyone, nobody hears himself."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest

from mavins.errors import TransportError
from mavins.transports.base import NOT_ADMITTED, Link
from mavins.transports.multicast import MulticastTransport

GROUP = "239.255.145.50"
LIMIT_S = 10.0


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
        return number


@pytest.fixture
def members(port: int) -> Iterator[list[MulticastTransport]]:
    try:
        made = [MulticastTransport(GROUP, port, "127.0.0.1") for _ in range(3)]
    except TransportError as error:
        pytest.skip(f"no multicast on loopback here: {error}")
    yield made
    for one in made:
        one.close()


def heard(member: Link, n: int) -> list[bytes]:
    got: list[bytes] = []
    deadline = time.monotonic() + LIMIT_S
    while len(got) < n and time.monotonic() < deadline:
        for data, address in member.recv(0.05):
            assert address == member.peers[0]
            got.append(data)
    return got


def test_all_but_the_sender_hear(members: list[MulticastTransport], port: int) -> None:
    one, two, three = members
    assert one.announcement == f"joined udp {GROUP}:{port}"
    assert one.peers == ((GROUP, port),)
    for k in range(20):
        one.send(bytes([k]), (GROUP, port))
    assert heard(two, 20) == heard(three, 20) == [bytes([k]) for k in range(20)]
    two.send(b"answer")
    assert heard(one, 1) == [b"answer"]
    assert heard(three, 1) == [b"answer"]
    assert one.recv(0.05) == two.recv(0.05) == []


def test_an_interface_that_is_not_ours(port: int) -> None:
    with pytest.raises(TransportError, match=r"not on interface 192\.0\.2\.99"):
        MulticastTransport(GROUP, port, "192.0.2.99")


def test_a_closed_member_is_quiet(members: list[MulticastTransport]) -> None:
    members[0].close()
    members[0].close()
    members[0].send(b"x")
    assert members[0].recv(0.0) == []
    assert members[0].send_errors == 1


def test_a_member_who_may_not_send_is_not_heard(
    members: list[MulticastTransport], port: int
) -> None:
    deaf = MulticastTransport(GROUP, port, "127.0.0.1", lambda host: False)
    members[0].send(b"x")
    assert heard(members[1], 1) == [b"x"]
    assert deaf.recv(0.2) == []
    assert deaf.dropped[NOT_ADMITTED] == 1
    deaf.close()
