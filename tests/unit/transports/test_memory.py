"""The tests' own transport."""

from mavins.transports.base import Transport
from mavins.transports.memory import MemoryNetwork, pair
from mavins.transports.udp import UdpTransport


def test_a_pair_talks() -> None:
    left, right = pair()
    left.send(b"one", right.address)
    left.send(b"two", right.address)
    assert right.recv() == [(b"one", left.address), (b"two", left.address)]
    assert right.recv(1.0) == []


def test_nobody_at_an_address_is_counted() -> None:
    network = MemoryNetwork()
    one, two = network.open(("one", 1)), network.open(("two", 1))
    two.close()
    one.send(b"lost", ("two", 1))
    assert one.send_errors == 1


def test_both_are_transports() -> None:
    def use(transport: Transport) -> int:
        return transport.send_errors

    udp = UdpTransport.bind("127.0.0.1", 0)
    assert use(udp) == use(pair()[0]) == 0
    udp.close()
