"""UDP: a bound socket that hears everyone, or a client that talks to one address.

A bound one opens a socket more at the same port for each preferred peer (a vehicle), connected to it. The kernel then
puts that peer's datagrams into a buffer of their own, which a flood from elsewhere cannot fill; they are read first.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
from collections import Counter
from collections.abc import Collection
from typing import Final

from mavins.errors import TransportError
from mavins.transports.base import Address, Datagram, address_text
from mavins.transports.sockets import bound, family_of, resolve

RECEIVE_BUFFER: Final = 4 << 20
"""Bytes asked of the system: a second of many streams, should the receiver be busy (it may grant
less).
"""
MAX_DATAGRAM: Final = 65535
MAX_DRAIN: Final = 64
"""Datagrams of a socket handed over at once, so that a flood cannot keep the caller from its other work."""
MAX_BACKLOG: Final = 1 << 14
"""Datagrams that are read before a preferred peer has its own socket, so that none of its overtakes another."""
_SO_MEMINFO: Final = 55
_MEMINFO: Final = struct.Struct("9I")


class UdpTransport:
    """One UDP socket that never blocks; made by `bind` or `client`."""

    is_stream = False
    trusted = False

    def __init__(self, sock: socket.socket, peer: Address | None = None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket = sock
        self._preferred: dict[Address, socket.socket] = {}
        self._backlog: list[Datagram] = []
        self._poll = select.epoll() if peer is None and hasattr(select, "epoll") else None
        if self._poll is not None:
            self._poll.register(sock, select.EPOLLIN)
        self._peer = peer
        self._address: Address = sock.getsockname()[:2]
        self.peers: tuple[Address, ...] = () if peer is None else (peer,)
        self.announcement = (
            f"listening udp {address_text(self._address)}"
            if peer is None
            else f"sending udp {address_text(peer)}"
        )
        self.send_errors = 0
        self.receive_errors = 0
        self._lost = 0
        self._lost_preferred = 0

    @classmethod
    def bind(cls, host: str, port: int) -> UdpTransport:
        """Listen on a port (0: any free one) of the interface `host`; an empty host means all IPv4
        interfaces, `::` those of IPv6 too.
        """
        return cls(bound(socket.SOCK_DGRAM, host, port))

    @classmethod
    def client(cls, host: str, port: int) -> UdpTransport:
        """Talk to one address from a free port; datagrams of others are not heard."""
        peer = resolve(host or "127.0.0.1", port)
        sock = socket.socket(family_of(peer[0]), socket.SOCK_DGRAM)
        try:
            sock.connect(peer)
        except OSError as error:
            sock.close()
            where = address_text((host, port))
            raise TransportError(f"cannot send to {where}: {error.strerror}") from error
        return cls(sock, peer)

    @property
    def dropped(self) -> Counter[str]:
        """What was not sent, and what the kernel had no room for, as a link counts it."""
        return Counter(
            {
                "not sent": self.send_errors,
                "dropped by the kernel": self._lost + _kernel_drops(self._socket),
                "dropped by the kernel, of vehicles": self._lost_preferred
                + sum(map(_kernel_drops, self._preferred.values())),
            }
        )

    @property
    def address(self) -> Address:
        """The (host, port) that we are bound to; host 0.0.0.0 means all interfaces."""
        return self._address

    def fileno(self) -> int:
        """The file descriptor, for a selector; -1 once closed."""
        if self._poll is None or self._poll.closed:
            return self._socket.fileno()
        return self._poll.fileno()

    def recv(self, timeout: float = 0.0) -> list[Datagram]:
        """Datagrams that wait, those of preferred peers first; when none does, wait up to `timeout` s
        (0: not at all) for the first.
        """
        datagrams = self._drain()
        if not datagrams and timeout > 0.0 and self.fileno() >= 0:
            select.select([self.fileno()], [], [], timeout)
            datagrams = self._drain()
        return datagrams

    def prefer(self, peers: Collection[Address]) -> None:
        """Whose datagrams shall neither wait behind nor be lost to those of all others, from now on."""
        if self._poll is None or peers == self._preferred.keys():
            return
        for address in self._preferred.keys() - set(peers):
            sock = self._preferred.pop(address)
            self._read(sock, MAX_BACKLOG, self._backlog)
            self._poll.unregister(sock)
            self._lost_preferred += _kernel_drops(sock)
            sock.close()
        for address in set(peers) - self._preferred.keys():
            with contextlib.suppress(OSError):  # without one it is heard as before
                sock = self._connected(address)
                self._read(self._socket, MAX_BACKLOG, self._backlog)
                self._preferred[address] = sock
                self._poll.register(sock, select.EPOLLIN)

    def _connected(self, peer: Address) -> socket.socket:
        """A socket at our own port that hears one peer; no other program may come to that port meanwhile or later."""
        sock = socket.socket(self._socket.family, socket.SOCK_DGRAM)
        try:
            if sock.family == socket.AF_INET6:
                only = self._socket.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY)
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, only)
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            both = (self._socket, sock)
            for each in both:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                sock.bind(self._socket.getsockname())
                sock.connect(peer)
            finally:
                for each in both:
                    each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        except OSError:
            sock.close()
            raise
        return sock

    def _drain(self) -> list[Datagram]:
        datagrams, self._backlog = self._backlog, []
        for sock in self._preferred.values():
            self._read(sock, MAX_DRAIN, datagrams)
        self._read(self._socket, MAX_DRAIN, datagrams)
        return datagrams

    def _read(self, sock: socket.socket, limit: int, datagrams: list[Datagram]) -> None:
        """Append what waits at a socket."""
        for _ in range(limit):
            try:
                data, address = sock.recvfrom(MAX_DATAGRAM)
                datagrams.append((data, address[:2]))
            except BlockingIOError:
                break
            except OSError:
                # an earlier datagram of ours was refused (ICMP), or the socket is closed
                self.receive_errors += 1
                if sock.fileno() < 0:
                    break

    def send(self, data: bytes, address: Address | None = None) -> None:
        """Send one datagram (a client: to its peer); refusals and full buffers are counted, never
        raised.
        """
        try:
            if self._peer is not None:
                self._socket.send(data)
            elif address is not None:
                self._socket.sendto(data, address)
        except OSError:
            self.send_errors += 1

    def tick(self) -> None:
        """Nothing is due by the clock."""

    def close(self) -> None:
        """Close the sockets."""
        self._lost = self.dropped["dropped by the kernel"]
        self._lost_preferred = self.dropped["dropped by the kernel, of vehicles"]
        for sock in (*self._preferred.values(), self._socket):
            sock.close()
        self._preferred.clear()
        if self._poll is not None:
            self._poll.close()


def _kernel_drops(sock: socket.socket) -> int:
    """Datagrams that found the buffer of a socket full, where the system tells (Linux)."""
    try:
        content = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        return int(_MEMINFO.unpack(content)[8])
    except (OSError, struct.error):
        return 0
