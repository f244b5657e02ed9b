"""UDP: a bound socket that hears everyone, or a client that talks to one address."""

from __future__ import annotations

import select
import socket
from collections import Counter
from typing import Final

from mavins.errors import TransportError
from mavins.transports.base import Address, Datagram, address_text
from mavins.transports.sockets import bound, family_of, resolve

RECEIVE_BUFFER: Final = 4 << 20
"""Bytes asked of the system: a second of many streams, should the receiver be busy (it may grant
less).
"""
MAX_DATAGRAM: Final = 65535
MAX_DRAIN: Final = 1024
"""Datagrams handed over at once, so that a flood cannot keep the caller from its other work."""


class UdpTransport:
    """One UDP socket that never blocks; made by `bind` or `client`."""

    is_stream = False
    trusted = False

    def __init__(self, sock: socket.socket, peer: Address | None = None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket = sock
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
        """What was not sent, as a link counts it."""
        return Counter({"not sent": self.send_errors})

    @property
    def address(self) -> Address:
        """The (host, port) that we are bound to; host 0.0.0.0 means all interfaces."""
        return self._address

    def fileno(self) -> int:
        """The file descriptor, for a selector; -1 once closed."""
        return self._socket.fileno()

    def recv(self, timeout: float = 0.0) -> list[Datagram]:
        """All datagrams that wait; when none does, wait up to `timeout` s (0: not at all) for the
        first.
        """
        datagrams = self._drain()
        if not datagrams and timeout > 0.0 and self.fileno() >= 0:
            select.select([self._socket], [], [], timeout)
            datagrams = self._drain()
        return datagrams

    def _drain(self) -> list[Datagram]:
        datagrams: list[Datagram] = []
        for _ in range(MAX_DRAIN):
            try:
                data, address = self._socket.recvfrom(MAX_DATAGRAM)
                datagrams.append((data, address[:2]))
            except BlockingIOError:
                break
            except OSError:
                # an earlier datagram of ours was refused (ICMP), or the socket is closed
                self.receive_errors += 1
                if self.fileno() < 0:
                    break
        return datagrams

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
        """Close the socket."""
        self._socket.close()
