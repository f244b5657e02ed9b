"""UDP over IPv4: a bound socket that hears everyone, or a client that talks to one address."""

from __future__ import annotations

import errno
import select
import socket
from typing import Final

from mavins.errors import TransportError
from mavins.transports.base import Address, Datagram

RECEIVE_BUFFER: Final = 4 << 20
"""Bytes asked of the system: a second of many streams, should the receiver be busy (it may grant
less).
"""
MAX_DATAGRAM: Final = 65535
MAX_DRAIN: Final = 1024
"""Datagrams handed over at once, so that a flood cannot keep the caller from its other work."""


class UdpTransport:
    """One UDP socket that never blocks; made by `bind` or `client`."""

    def __init__(self, sock: socket.socket, peer: Address | None = None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket = sock
        self._peer = peer
        self._address: Address = sock.getsockname()[:2]
        self.send_errors = 0
        self.receive_errors = 0

    @classmethod
    def bind(cls, host: str, port: int) -> UdpTransport:
        """Listen on a port (0: any free one) of the interface `host`; an empty host means all
        interfaces.
        """
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.bind((resolve(host)[0] if host else "", port))
        except OSError as error:
            sock.close()
            raise TransportError(_why(host, port, error)) from error
        except TransportError:
            sock.close()
            raise
        return cls(sock)

    @classmethod
    def client(cls, host: str, port: int) -> UdpTransport:
        """Talk to one address from a free port; datagrams of others are not heard."""
        peer = resolve(host or "127.0.0.1", port)
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.connect(peer)
        except OSError as error:
            sock.close()
            raise TransportError(f"cannot send to {host}:{port}: {error.strerror}") from error
        return cls(sock, peer)

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
                datagrams.append(self._socket.recvfrom(MAX_DATAGRAM))
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

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def resolve(host: str, port: int = 0) -> Address:
    """The IPv4 address of a host name; TransportError where there is none."""
    try:
        found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError, OverflowError) as error:
        raise TransportError(f"no host is called '{host}'") from error
    address = found[0][4]
    return str(address[0]), int(address[1])


def _why(host: str, port: int, error: OSError) -> str:
    where = f"udp {host or '0.0.0.0'}:{port}"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{where} is in use by another program: take another port, or, where a ground station "
            "on this host holds 14550, `mavins serve --udp 14540 --gcs 127.0.0.1:14550`"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{where}: no interface of this host has that address"
    if error.errno == errno.EACCES:
        return f"{where}: not permitted; take a port above 1023"
    return f"{where}: {error.strerror}"
