"""TCP: a client that connects again when it must, and a server for many clients."""

from __future__ import annotations

import errno
import os
import selectors
import socket
import time
from collections.abc import Callable
from typing import Final

from mavins.transports.base import NOT_ADMITTED, Address, Admits, Say, address_text, everyone
from mavins.transports.sockets import bound, family_of, resolve
from mavins.transports.stream import Connection, Reconnecting, StreamTransport

QUEUE_BYTES: Final = 1 << 16
"""Some seconds of all streams."""
MAX_CLIENTS: Final = 32
CONNECT_LIMIT_S: Final = 5.0
SILENCE_LIMIT_S: Final = 10
"""After so long without an acknowledgement a connection counts as broken."""


class TcpClient(Reconnecting):
    """Talks to one server; the first attempt to connect is made by the first `tick`."""

    def __init__(
        self, host: str, port: int, say: Say, clock: Callable[[], float] = time.monotonic
    ) -> None:
        peer = resolve(host or "127.0.0.1", port)
        super().__init__(f"tcp {address_text(peer)}", peer, say, clock)
        self.announcement = f"connecting {self.name}"
        self._socket: socket.socket | None = None
        self._give_up = 0.0

    def tick(self) -> None:
        """Try again, when it is time; give up an attempt that takes too long."""
        if self._socket is None:
            super().tick()
        elif self._clock() >= self._give_up:
            self._abandon("no answer")

    def _attempt(self) -> None:
        sock = self._socket = socket.socket(family_of(self._peer[0]), socket.SOCK_STREAM)
        sock.setblocking(False)
        self._give_up = self._clock() + CONNECT_LIMIT_S
        self._selector.register(sock, selectors.EVENT_WRITE, self._connected)
        error = sock.connect_ex(self._peer)
        if error not in (0, errno.EINPROGRESS):
            self._abandon(os.strerror(error))

    def _abandon(self, why: str) -> None:
        assert self._socket is not None
        self._selector.unregister(self._socket)
        self._socket.close()
        self._socket = None
        self._failed(why)

    def _connected(self) -> None:
        sock = self._socket
        assert sock is not None
        error = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        # where nobody listens on a port of this host, a client may come to meet itself
        if not error and sock.getsockname() == sock.getpeername():
            error = errno.ECONNREFUSED
        if error:
            self._abandon(os.strerror(error))
            return
        self._selector.unregister(sock)
        self._socket = None
        _prepare(sock)
        self._add(Connection(sock.fileno(), self._peer, sock.close, QUEUE_BYTES, self.dropped))

    def close(self) -> None:
        """Close the connection, or give up the attempt."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        super().close()


class TcpServer(StreamTransport):
    """Listens on a port (0: any free one); an empty host means all IPv4 interfaces, `::` all.

    A client whom `admits` refuses is hung up on at once.
    """

    def __init__(self, host: str, port: int, say: Say, admits: Admits = everyone) -> None:
        self._admits = admits
        self._socket = bound(socket.SOCK_STREAM, host, port)
        self._socket.listen()
        self._socket.setblocking(False)
        host, port = self._socket.getsockname()[:2]
        self.address: Address = (host, port)
        super().__init__(f"tcp {address_text(self.address)}", say)
        self.announcement = f"listening {self.name}"
        self._is_accepting = False
        self.tick()

    def tick(self) -> None:
        """Accept again after descriptors had run out."""
        if not self._is_accepting and self._fd >= 0:
            self._selector.register(self._socket, selectors.EVENT_READ, self._accept)
            self._is_accepting = True

    def _accept(self) -> None:
        try:
            sock, address = self._socket.accept()
        except (BlockingIOError, ConnectionError):
            return
        except OSError:
            # no descriptors left: the selector would tell of the client without end
            self._selector.unregister(self._socket)
            self._is_accepting = False
            return
        reason = self._objection(address[0])
        if reason:
            self.dropped[reason] += 1
            sock.close()
            return
        sock.setblocking(False)
        _prepare(sock)
        host, port = address[:2]
        self._add(Connection(sock.fileno(), (host, port), sock.close, QUEUE_BYTES, self.dropped))

    def _objection(self, host: str) -> str:
        """Why a client is not taken, or nothing."""
        if not self._admits(host):
            return NOT_ADMITTED
        return f"more clients than {MAX_CLIENTS}" if len(self._connections) >= MAX_CLIENTS else ""

    def close(self) -> None:
        """Close the port and every connection."""
        super().close()
        self._socket.close()


def _prepare(sock: socket.socket) -> None:
    """No waiting for full segments, and a vanished other side is noticed."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", SILENCE_LIMIT_S // 2),
        ("TCP_KEEPINTVL", 1),
        ("TCP_KEEPCNT", SILENCE_LIMIT_S // 2),
        ("TCP_USER_TIMEOUT", SILENCE_LIMIT_S * 1000),
    ):
        if hasattr(socket, name):  # not every system has them all
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
