"""Streams of bytes: what TCP and a serial line have in common.

A slow or stuck other side never blocks: what it does not take waits in a bounded queue, and the
oldest whole packets are dropped when that is full. A stream that ends is opened again, with waits
that grow.
"""

from __future__ import annotations

import os
import selectors
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Collection
from typing import Final

from mavins.transports.base import Address, Datagram, Say

READ_SIZE: Final = 1024
"""Bytes of a connection handed over at once, so that no stream keeps the caller long from the others."""
FIRST_WAIT_S: Final = 0.5
LONGEST_WAIT_S: Final = 5.0

CONGESTED: Final = "link congested"
LOST: Final = "link lost"
NOT_SENT: Final = "not sent"


class Connection:
    """One open stream by its descriptor, which does not block; `limit` bounds what waits, in bytes."""

    def __init__(
        self,
        fd: int,
        address: Address,
        close: Callable[[], None],
        limit: int,
        dropped: Counter[str],
    ) -> None:
        self.fd = fd
        self.address = address
        self.close = close
        self.was_heard = False
        self._limit = limit
        self._dropped = dropped
        self._queue: deque[bytes] = deque()
        self._size = 0
        self._begun = 0  # bytes of the first packet that are out

    @property
    def is_waiting(self) -> bool:
        """True while there is something left to be written."""
        return bool(self._queue)

    def read(self) -> bytes:
        """What has come; empty at the end of the stream."""
        return os.read(self.fd, READ_SIZE)

    def send(self, packet: bytes) -> None:
        """Write a packet, or keep it until there is room."""
        self._queue.append(packet)
        self._size += len(packet)
        if len(self._queue) == 1:
            self.flush()
        # one that has begun to go out is finished, or the other side would see it damaged
        oldest = 1 if self._begun else 0
        while self._size > self._limit and len(self._queue) > oldest + 1:
            self._size -= len(self._queue[oldest])
            del self._queue[oldest]
            self._dropped[CONGESTED] += 1

    def flush(self) -> None:
        """Write what waits, as far as there is room."""
        while self._queue:
            packet = self._queue[0]
            try:
                self._begun += os.write(self.fd, packet[self._begun :])
            except BlockingIOError:
                return
            if self._begun < len(packet):
                return
            self._begun = 0
            self._size -= len(packet)
            self._queue.popleft()


class StreamTransport:
    """Any number of connections behind one descriptor: that of the selector which watches them."""

    is_stream = True
    trusted = False
    peers: tuple[Address, ...] = ()

    def __init__(self, name: str, say: Say) -> None:
        self.name = name
        self.dropped: Counter[str] = Counter()
        self._say = say
        self._connections: dict[Address, Connection] = {}
        self._selector = selectors.DefaultSelector()
        self._fd = self._selector.fileno()

    @property
    def send_errors(self) -> int:
        """How many packets could not be sent."""
        return self.dropped[NOT_SENT] + self.dropped[CONGESTED]

    def fileno(self) -> int:
        """A descriptor that is readable when something is to be done; -1 once closed."""
        return self._fd

    def recv(self, timeout: float = 0.0) -> list[Datagram]:
        """What has come, a piece from each connection; an empty piece where one ended."""
        pieces: list[Datagram] = []
        if self._fd < 0:
            return pieces
        for key, events in self._selector.select(timeout):
            if isinstance(key.data, Connection):
                self._serve(key.data, events, pieces)
            else:
                key.data()
        return pieces

    def _serve(self, connection: Connection, events: int, pieces: list[Datagram]) -> None:
        try:
            if events & selectors.EVENT_WRITE:
                connection.flush()
            if events & selectors.EVENT_READ:
                data = connection.read()
                pieces.append((data, connection.address))
                if not data:
                    self._end(connection, "the other side hung up")
                    return
                if not connection.was_heard:
                    connection.was_heard = True
                    self._heard()
            self._watch(connection)
        except BlockingIOError:
            pass
        except OSError as error:
            pieces.append((b"", connection.address))
            self._end(connection, error.strerror or str(error))

    def send(self, data: bytes, address: Address) -> None:
        """Send one packet to a connection; with nobody there it is counted."""
        connection = self._connections.get(address)
        if connection is None:
            self.dropped[NOT_SENT] += 1
            return
        try:
            connection.send(data)
            self._watch(connection)
        except OSError:
            # reading tells the same at once, and there the connection ends
            self.dropped[NOT_SENT] += 1

    def _add(self, connection: Connection) -> None:
        self._connections[connection.address] = connection
        self._selector.register(connection.fd, selectors.EVENT_READ, connection)

    def _watch(self, connection: Connection) -> None:
        """Have the selector tell of room only while something waits for it."""
        events = selectors.EVENT_READ
        if connection.is_waiting:
            events |= selectors.EVENT_WRITE
        if self._selector.get_key(connection.fd).events != events:
            self._selector.modify(connection.fd, events, connection)

    def _end(self, connection: Connection, why: str) -> None:
        self._selector.unregister(connection.fd)
        connection.close()
        del self._connections[connection.address]
        self._ended(connection, why)

    def _heard(self) -> None:
        """The first bytes of a connection have come."""

    def _ended(self, connection: Connection, why: str) -> None:
        """A connection is gone."""

    def prefer(self, peers: Collection[Address]) -> None:
        """Each connection has a buffer of its own."""

    def tick(self) -> None:
        """Nothing is due by the clock."""

    def close(self) -> None:
        """Close every connection."""
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()
        self._selector.close()
        self._fd = -1


class Reconnecting(StreamTransport, ABC):
    """A stream to one other side, which is opened again whenever it ends."""

    def __init__(
        self, name: str, peer: Address, say: Say, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(name, say)
        self.peers = (peer,)
        self._clock = clock
        self._peer = peer
        self._wait = FIRST_WAIT_S
        self._next_attempt = clock()
        self._was_told = False

    @property
    def address(self) -> Address:
        """The other side, which is all there is to name."""
        return self._peer

    @property
    def is_open(self) -> bool:
        """True while there is a connection."""
        return self._peer in self._connections

    def tick(self) -> None:
        """Try again, when it is time."""
        if self._fd >= 0 and not self.is_open and self._clock() >= self._next_attempt:
            self._attempt()

    @abstractmethod
    def _attempt(self) -> None:
        """Begin to open the stream; ends in `_add` or in `_failed`."""

    def _failed(self, why: str) -> None:
        if not self._was_told:
            self._say(f"{self.name}: {why}; trying again")
            self._was_told = True
        self._next_attempt = self._clock() + self._wait
        self._wait = min(2.0 * self._wait, LONGEST_WAIT_S)

    def _heard(self) -> None:
        """Only what was heard from counts as there: some accept and hang up, for ever."""
        if self._was_told:
            self._say(f"{self.name} connected")
        self._was_told = False
        self._wait = FIRST_WAIT_S

    def _ended(self, connection: Connection, why: str) -> None:
        self.dropped[LOST] += 1
        self._failed(f"lost, {why}")
