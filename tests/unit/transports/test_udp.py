"""UDP on loopback: datagrams both ways, a busy port, and peers that are not there."""

from __future__ import annotations

import socket
import time

import pytest

from mavins.errors import TransportError
from mavins.transports.base import Datagram, parse_address
from mavins.transports.udp import UdpTransport


@pytest.fixture
def server():  # type: ignore[no-untyped-def]
    transport = UdpTransport.bind("127.0.0.1", 0)
    yield transport
    transport.close()


def drained(transport: UdpTransport, n: int) -> list[bytes]:
    got: list[bytes] = []
    deadline = time.monotonic() + 5.0
    while len(got) < n and time.monotonic() < deadline:
        got += [data for data, _ in transport.recv(0.2)]
    return got


def test_datagrams_go_both_ways_whole_and_in_order(server: UdpTransport) -> None:
    client = UdpTransport.client(*server.address)
    sent = [bytes([k]) * (k + 1) for k in range(50)]
    for data in sent:
        client.send(data)
    got: list[bytes] = []
    while len(got) < 50:
        for data, address in server.recv(1.0):
            got.append(data)
            server.send(data[::-1], address)
    assert got == sent
    assert drained(client, 50) == [data[::-1] for data in sent]
    client.close()


def test_recv_does_not_wait_when_told_not_to(server: UdpTransport) -> None:
    start = time.monotonic()
    assert server.recv(0.0) == []
    assert time.monotonic() - start < 2.0
    assert server.recv(0.05) == []


def test_a_port_alone_binds_all_interfaces() -> None:
    transport = UdpTransport.bind("", 0)
    assert transport.address[0] == "0.0.0.0"
    client = UdpTransport.client("127.0.0.1", transport.address[1])
    client.send(b"hello")
    assert drained(transport, 1) == [b"hello"]
    client.close()
    transport.close()


def test_a_busy_port_says_the_way_out(server: UdpTransport) -> None:
    with pytest.raises(TransportError) as caught:
        UdpTransport.bind("127.0.0.1", server.address[1])
    message = str(caught.value)
    assert "in use" in message
    assert "serve --udp 14540 --gcs 127.0.0.1:14550" in message
    assert "\n" not in message


def test_an_address_that_is_not_ours() -> None:
    with pytest.raises(TransportError, match="no interface"):
        UdpTransport.bind("192.0.2.1", 0)
    with pytest.raises(TransportError, match="no host is called"):
        UdpTransport.bind("no host", 0)


def test_nobody_there_is_counted_never_raised(server: UdpTransport) -> None:
    host, port = server.address
    client = UdpTransport.client(host, port)
    server.close()
    for _ in range(20):
        client.send(b"x")
        client.recv(0.01)
    assert client.send_errors + client.receive_errors > 0
    other = UdpTransport.bind("127.0.0.1", 0)
    other.send(b"x" * 70_000, (host, port))  # larger than any datagram
    assert other.send_errors == 1
    other.close()
    client.close()


def test_a_closed_transport_is_quiet() -> None:
    transport = UdpTransport.bind("127.0.0.1", 0)
    transport.close()
    transport.close()
    assert transport.recv(0.0) == []
    transport.send(b"x", ("127.0.0.1", 9))


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("14550", ("", 14550)),
        ("a.b:1", ("a.b", 1)),
        ("127.0.0.1:0", ("127.0.0.1", 0)),
        ("[::1]:14550", ("::1", 14550)),
    ],
)
def test_parse_address(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize(
    "text", ["", "host", "host:", "1:70000", "1:-5", "a:b:c", "14550x", "¹", "::1:14550"]
)
def test_parse_address_refuses(text: str) -> None:
    with pytest.raises(TransportError, match="HOST:PORT"):
        parse_address(text)


def test_ipv6_both_ways() -> None:
    server = UdpTransport.bind("::1", 0)
    assert server.announcement == f"listening udp [::1]:{server.address[1]}"
    client = UdpTransport.client("::1", server.address[1])
    client.send(b"there")
    ((data, address),) = server.recv(1.0)
    assert (data, address[0]) == (b"there", "::1")
    server.send(b"back", address)
    assert drained(client, 1) == [b"back"]
    client.close()
    server.close()


def test_both_families_at_one_port() -> None:
    server = UdpTransport.bind("::", 0)
    for host, seen in (("127.0.0.1", "::ffff:127.0.0.1"), ("::1", "::1")):
        client = UdpTransport.client(host, server.address[1])
        client.send(b"there")
        ((_, address),) = server.recv(1.0)
        assert address[0] == seen
        server.send(b"back", address)
        assert drained(client, 1) == [b"back"]
        client.close()
    server.close()


def test_a_link_to_one_address_sends_to_it_unasked(server: UdpTransport) -> None:
    client = UdpTransport.client(*server.address)
    assert client.peers == (server.address,)
    assert client.announcement == f"sending udp 127.0.0.1:{server.address[1]}"
    assert server.peers == ()
    assert server.announcement == f"listening udp 127.0.0.1:{server.address[1]}"
    client.close()


def test_a_preferred_peer_has_a_buffer_of_its_own(server: UdpTransport) -> None:
    vehicle, other = UdpTransport.client(*server.address), UdpTransport.client(*server.address)
    vehicle.send(b"before")
    server.prefer([vehicle.address])
    server.prefer([vehicle.address])
    flood = bytes(2000)
    for _ in range(10_000):
        other.send(flood)
    for k in range(100):
        vehicle.send(bytes([k]))
    lost = server.dropped["dropped by the kernel"]
    got: list[Datagram] = []
    while len([d for d, a in got if a == vehicle.address]) < 101:
        batch = server.recv(1.0)
        assert batch
        got += batch
    mine = [data for data, address in got if address == vehicle.address]
    assert mine == [b"before", *(bytes([k]) for k in range(100))]
    assert server.dropped["dropped by the kernel, of vehicles"] == 0
    while batch := server.recv(0.05):
        got += batch
    # each datagram of the flood came, or was counted by the kernel
    assert len(got) - 101 + lost == 10_000
    # answers still come from our one port
    server.send(b"answer", vehicle.address)
    assert vehicle.recv(1.0) == [(b"answer", server.address)]
    vehicle.close()
    other.close()


def test_a_peer_that_is_not_preferred_any_more_loses_nothing(server: UdpTransport) -> None:
    client = UdpTransport.client(*server.address)
    server.prefer([client.address])
    for k in range(200):
        client.send(bytes([k]))
    server.prefer([])
    client.send(b"after")
    assert drained(server, 201) == [*(bytes([k]) for k in range(200)), b"after"]
    client.close()


def test_a_port_with_preferred_peers_is_still_ours_alone(server: UdpTransport) -> None:
    client = UdpTransport.client(*server.address)
    server.prefer([client.address])
    with pytest.raises(TransportError, match="in use"):
        UdpTransport.bind(*server.address)
    thief = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    with pytest.raises(OSError, match="in use"):
        thief.bind(server.address)
    thief.close()
    client.close()


def test_preferring_on_all_interfaces_and_of_both_families() -> None:
    for host, to in (("", "127.0.0.1"), ("::", "::1"), ("::", "127.0.0.1")):
        server = UdpTransport.bind(host, 0)
        client = UdpTransport.client(to, server.address[1])
        client.send(b"hello")
        ((_, address),) = server.recv(1.0)
        server.prefer([address])
        client.send(b"again")
        assert server.recv(1.0) == [(b"again", address)]
        assert list(server._preferred) == [address]
        server.send(b"answer", address)
        assert [data for data, _ in client.recv(1.0)] == [b"answer"]
        client.close()
        server.close()
        assert server.fileno() == -1


def test_a_preferred_peer_that_has_gone_does_no_harm(server: UdpTransport) -> None:
    client = UdpTransport.client(*server.address)
    address = client.address
    server.prefer([address])
    client.close()
    for _ in range(5):
        server.send(b"into the void", address)
        assert server.recv(0.02) == []
    server.prefer([("300.1.1.1", 9)])
    assert server.recv(0.0) == []
