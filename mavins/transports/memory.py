"""Datagrams between objects of one process: the transport of the tests. Nothing waits, nothing is
lost.
"""

from __future__ import annotations

from collections import deque

from mavins.transports.base import Address, Datagram


class MemoryNetwork:
    """A network of memory transports, each at an address of its own."""

    def __init__(self) -> None:
        self._inboxes: dict[Address, deque[Datagram]] = {}

    def open(self, address: Address) -> MemoryTransport:
        """A transport at `address`; opening it again empties its inbox."""
        inbox = self._inboxes[address] = deque[Datagram]()
        return MemoryTransport(self, address, inbox)

    def deliver(self, data: bytes, sender: Address, receiver: Address) -> bool:
        """Put a datagram into the receiver's inbox; False where nobody is."""
        inbox = self._inboxes.get(receiver)
        if inbox is None:
            return False
        inbox.append((data, sender))
        return True

    def leave(self, address: Address) -> None:
        """Take the transport at `address` off the network."""
        self._inboxes.pop(address, None)


class MemoryTransport:
    """One end; made by `MemoryNetwork.open` or `pair`."""

    def __init__(self, network: MemoryNetwork, address: Address, inbox: deque[Datagram]) -> None:
        self._network = network
        self._address = address
        self._inbox = inbox
        self.send_errors = 0

    @property
    def address(self) -> Address:
        """Where we can be reached."""
        return self._address

    def recv(self, timeout: float = 0.0) -> list[Datagram]:
        """All datagrams that wait; there is no waiting here, whatever `timeout` says."""
        datagrams = list(self._inbox)
        self._inbox.clear()
        return datagrams

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram; nobody at `address` is counted."""
        if not self._network.deliver(data, self._address, address):
            self.send_errors += 1

    def close(self) -> None:
        """Leave the network."""
        self._network.leave(self._address)


def pair() -> tuple[MemoryTransport, MemoryTransport]:
    """Two transports that reach each other, at ("left", 1) and ("right", 2)."""
    network = MemoryNetwork()
    return network.open(("left", 1)), network.open(("right", 2))
