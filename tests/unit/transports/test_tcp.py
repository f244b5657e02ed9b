"""TCP on loopback: both ways, servers that come and go, clients that do not read, and nobody waits."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from mavins.errors import TransportError
from mavins.transports import tcp
from mavins.transports.base import NOT_ADMITTED, Link
from mavins.transports.stream import CONGESTED, FIRST_WAIT_S, LONGEST_WAIT_S, LOST, NOT_SENT
from mavins.transports.tcp import QUEUE_BYTES, TcpClient, TcpServer
from mavins.transports.udp import UdpTransport

LIMIT_S = 10.0


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def pieces(link: Link, until: Callable[[list[Any]], bool]) -> list[Any]:
    """All that comes until there is enough."""
    got: list[Any] = []
    deadline = time.monotonic() + LIMIT_S
    while not until(got):
        assert time.monotonic() < deadline, got
        link.tick()
        got += link.recv(0.02)
    return got


def joined(got: list[Any]) -> bytes:
    return b"".join(data for data, _ in got)


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def server(told: list[str]) -> Iterator[TcpServer]:
    made = TcpServer("127.0.0.1", 0, told.append)
    yield made
    made.close()


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        sock.settimeout(LIMIT_S)
        yield sock


def client_of(listener: socket.socket, told: list[str], clock: Clock) -> tuple[TcpClient, Any]:
    """A client, and the server's end of its connection."""
    client = TcpClient(*listener.getsockname(), told.append, clock)
    client.tick()
    there, _ = listener.accept()
    pieces(client, lambda _: client.is_open)
    return client, there


def test_they_are_links() -> None:
    def use(link: Link) -> str:
        return link.announcement

    for made in (
        TcpServer("127.0.0.1", 0, print),
        TcpClient("127.0.0.1", 9, print),
        UdpTransport.bind("127.0.0.1", 0),
    ):
        assert use(made).split()[1] in ("tcp", "udp")
        made.close()


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "::"])
def test_both_ways_between_our_own_ends(host: str, told: list[str]) -> None:
    server = TcpServer(host, 0, told.append)
    there = "::1" if ":" in host else host
    client = TcpClient(there, server.address[1], told.append)
    assert (
        client.announcement
        == f"connecting tcp {'[::1]' if ':' in there else there}:{server.address[1]}"
    )
    pieces(client, lambda _: client.is_open)
    sent = [bytes([k]) * (k + 1) for k in range(100)]
    for data in sent:
        client.send(data, client.address)
    got = pieces(server, lambda got: len(joined(got)) == 5050)
    assert joined(got) == b"".join(sent)
    (address,) = {address for _, address in got}
    assert address[0] == there
    server.send(b"answer", address)
    assert pieces(client, lambda got: got != []) == [(b"answer", client.address)]
    client.close()
    assert pieces(server, lambda got: got != []) == [(b"", address)]
    server.send(b"too late", address)
    assert server.dropped == {NOT_SENT: 1}
    server.close()
    assert told == []


def test_both_families_at_one_port(told: list[str]) -> None:
    server = TcpServer("::", 0, told.append)
    with socket.create_connection(("127.0.0.1", server.address[1]), LIMIT_S) as sock:
        sock.sendall(b"four")
        ((data, (host, _)),) = pieces(server, lambda got: got != [])
    assert (data, host) == (b"four", "::ffff:127.0.0.1")
    server.close()


def test_many_clients_each_with_its_own(server: TcpServer) -> None:
    clients = [socket.create_connection(server.address, LIMIT_S) for _ in range(5)]
    for k, sock in enumerate(clients):
        sock.sendall(bytes([k]))
    got = pieces(server, lambda got: len(got) == 5)
    for data, address in got:
        server.send(data * 3, address)
    for k, sock in enumerate(clients):
        sock.settimeout(LIMIT_S)
        assert sock.recv(10) == bytes([k]) * 3
        sock.close()
    assert [data for data, _ in pieces(server, lambda got: len(got) == 5)] == [b""] * 5


def test_more_clients_than_there_is_room_for(
    server: TcpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp, "MAX_CLIENTS", 2)
    clients = [socket.create_connection(server.address, LIMIT_S) for _ in range(3)]
    pieces(server, lambda _: server.dropped["more clients than 2"] == 1)
    clients[2].settimeout(LIMIT_S)
    assert clients[2].recv(1) == b""
    clients[0].sendall(b"still served")
    assert joined(pieces(server, lambda got: got != [])) == b"still served"
    for sock in clients:
        sock.close()


def test_a_client_that_does_not_read_keeps_nobody_waiting(server: TcpServer) -> None:
    """What reaches it in the end is whole packets, the newest among them."""
    size = 250
    with socket.create_connection(server.address, LIMIT_S) as sock:
        sock.sendall(b"hello")
        ((_, address),) = pieces(server, lambda got: got != [])
        sent = 0
        while not server.dropped[CONGESTED] or sent % 1000:
            server.send(sent.to_bytes(4, "big") * (size // 4) + b"..", address)
            sent += 1
            assert sent < 1_000_000
        (connection,) = server._connections.values()
        assert connection._size <= QUEUE_BYTES
        dropped = server.dropped[CONGESTED]
        assert server.send_errors == dropped
        sock.setblocking(False)
        received = b""
        deadline = time.monotonic() + LIMIT_S
        while len(received) < (sent - dropped) * size and time.monotonic() < deadline:
            server.recv(0.0)
            if select.select([sock], [], [], 0.01)[0]:
                received += sock.recv(1 << 20)
    packets = [received[k : k + size] for k in range(0, len(received), size)]
    numbers = [int.from_bytes(packet[:4], "big") for packet in packets]
    assert all(
        p == n.to_bytes(4, "big") * (size // 4) + b".."
        for p, n in zip(packets, numbers, strict=True)
    )
    assert numbers == sorted(set(numbers))
    assert len(numbers) == sent - dropped
    assert numbers[-1] == sent - 1


def test_a_server_that_goes_and_comes_back(listener: socket.socket, told: list[str]) -> None:
    clock = Clock()
    client, there = client_of(listener, told, clock)
    there.sendall(b"one")
    assert joined(pieces(client, lambda got: got != [])) == b"one"
    there.close()
    assert pieces(client, lambda got: got != []) == [(b"", client.address)]
    assert client.dropped == {LOST: 1}
    assert [line.split(": ", 1)[1] for line in told] == [
        "lost, the other side hung up; trying again"
    ]
    client.send(b"into nothing", client.address)
    assert client.dropped[NOT_SENT] == 1
    client.tick()
    assert not select.select([listener], [], [], 0.05)[0]  # not before its time
    clock.now += FIRST_WAIT_S
    client.tick()
    there, _ = listener.accept()
    there.sendall(b"two")
    assert joined(pieces(client, lambda got: got != [])) == b"two"
    assert told[1:] == [f"{client.name} connected"]
    client.close()
    there.close()


def test_the_waits_grow_to_a_limit_and_are_told_of_once(told: list[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        address = gone.getsockname()
    clock = Clock()
    client = TcpClient(*address, told.append, clock)
    waits = []
    for _ in range(7):
        client.tick()
        deadline = time.monotonic() + LIMIT_S
        while client._socket is not None and time.monotonic() < deadline:
            client.recv(0.02)
        waits.append(client._next_attempt - clock.now)
        clock.now = client._next_attempt
    assert waits == [FIRST_WAIT_S, 1.0, 2.0, 4.0, LONGEST_WAIT_S, LONGEST_WAIT_S, LONGEST_WAIT_S]
    assert len(told) == 1
    assert "refused" in told[0]
    assert client.dropped[LOST] == 0
    client.close()


def test_one_that_accepts_and_hangs_up_is_told_of_once(
    listener: socket.socket, told: list[str]
) -> None:
    clock = Clock()
    client = TcpClient(*listener.getsockname(), told.append, clock)
    for _ in range(4):
        client.tick()
        listener.accept()[0].close()
        pieces(client, lambda got: got != [])
        clock.now += LONGEST_WAIT_S
    assert len(told) == 1
    client.close()


def test_an_attempt_without_an_answer_is_given_up(told: list[str]) -> None:
    """A server whose queue is full does not answer."""
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        waiting = [socket.socket() for _ in range(4)]
        for sock in waiting:
            sock.setblocking(False)
            sock.connect_ex(full.getsockname())
        clock = Clock()
        client = TcpClient(*full.getsockname(), told.append, clock)
        client.tick()
        assert client.recv(0.1) == []
        clock.now += tcp.CONNECT_LIMIT_S
        client.tick()
        assert told == [f"{client.name}: no answer; trying again"]
        client.close()
        for sock in waiting:
            sock.close()


def test_closed_ones_are_quiet(server: TcpServer, listener: socket.socket, told: list[str]) -> None:
    client, there = client_of(listener, told, Clock())
    for link in (client, server):
        link.close()
        link.close()
        link.tick()
        assert link.recv(0.0) == []
        assert link.fileno() == -1
        link.send(b"x", ("127.0.0.1", 9))
    there.close()


def test_what_cannot_be_opened(server: TcpServer, told: list[str]) -> None:
    with pytest.raises(TransportError, match="in use by another program: take another port"):
        TcpServer(*server.address, told.append)
    with pytest.raises(TransportError, match="no interface"):
        TcpServer("192.0.2.1", 0, told.append)
    with pytest.raises(TransportError, match="no host is called"):
        TcpClient("no-such-host.invalid", 1, told.append)


def test_a_client_who_may_not_send_is_hung_up_on(told: list[str]) -> None:
    server = TcpServer("127.0.0.1", 0, told.append, lambda host: host != "127.0.0.1")
    with socket.create_connection(server.address) as client:
        client.settimeout(LIMIT_S)
        client.sendall(b"x")
        deadline = time.monotonic() + LIMIT_S
        while not server.dropped and time.monotonic() < deadline:
            assert server.recv(0.02) == []
        with contextlib.suppress(ConnectionError):
            assert client.recv(1) == b""
    assert server.dropped == {NOT_ADMITTED: 1}
    server.close()
