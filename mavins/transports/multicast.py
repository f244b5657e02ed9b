"""UDP multicast: everyone in a group hears everyone, without a server between them."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Collection

from mavins.errors import TransportError
from mavins.transports.base import NOT_ADMITTED, Address, Admits, Datagram, address_text, everyone
from mavins.transports.udp import UdpTransport


class MulticastTransport(UdpTransport):
    """A member of an IPv4 group.

    The group is one address, whoever of its members has sent: what is sent goes to all of them, once. Members whom
    `admits` refuses are not heard.
    """

    def __init__(
        self, group: str, port: int, interface: str = "", admits: Admits = everyone
    ) -> None:
        """Join on the interface with that IPv4 address, or on the one that the system chooses."""
        self._admits = admits
        self._refused = 0
        self._group: Address = (group, port)
        self._out, sock = _out(self._group, interface), None
        try:
            sock = _joined(self._group, interface)
        except OSError as error:
            self._out.close()
            raise TransportError(_why(self._group, interface, error)) from error
        # what we send comes back to us, as it does to others of this host
        self._own: Address = self._out.getsockname()
        super().__init__(sock)
        self.peers = (self._group,)
        self.announcement = f"joined udp {address_text(self._group)}"

    def _drain(self) -> list[Datagram]:
        datagrams: list[Datagram] = []
        for data, sender in super()._drain():
            if sender == self._own:
                continue
            if self._admits(sender[0]):
                datagrams.append((data, self._group))
            else:
                self._refused += 1
        return datagrams

    @property
    def dropped(self) -> Counter[str]:
        """What was not sent, what the kernel had no room for, and what came from members who may not send."""
        return super().dropped + Counter({NOT_ADMITTED: self._refused})

    def prefer(self, peers: Collection[Address]) -> None:
        """All members are one address."""

    def send(self, data: bytes, address: Address | None = None) -> None:
        """Send one datagram to the group; a failure is counted, never raised."""
        try:
            self._out.send(data)
        except OSError:
            self.send_errors += 1

    def close(self) -> None:
        """Leave the group."""
        self._out.close()
        super().close()


def _out(group: Address, interface: str) -> socket.socket:
    """A socket that sends to the group, with an address of its own."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if interface:
            option = socket.inet_aton(interface)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, option)
        sock.connect(group)
        sock.setblocking(False)
    except OSError as error:
        sock.close()
        raise TransportError(_why(group, interface, error)) from error
    return sock


def _joined(group: Address, interface: str) -> socket.socket:
    """A socket that hears the group; others of this host may hear it too."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(group)
        membership = socket.inet_aton(group[0]) + socket.inet_aton(interface or "0.0.0.0")
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError:
        sock.close()
        raise
    return sock


def _why(group: Address, interface: str, error: OSError) -> str:
    where = f"multicast {address_text(group)}"
    if interface:
        return f"{where}: not on interface {interface}: {error.strerror}"
    return f"{where}: {error.strerror}; name an interface of this host, ?interface=192.168.1.5"
