"""What every transport does: datagrams in, datagrams out; the other side cannot make it raise."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from mavins.errors import TransportError

Address: TypeAlias = tuple[str, int]
"""A host and a port."""
Datagram: TypeAlias = tuple[bytes, Address]
"""Bytes and where they came from."""


class Transport(Protocol):
    """A place where datagrams arrive and leave."""

    @property
    def address(self) -> Address:
        """Where we can be reached."""

    @property
    def send_errors(self) -> int:
        """How many datagrams could not be sent."""

    def recv(self, timeout: float) -> list[Datagram]:
        """All datagrams that wait; when none does, wait up to `timeout` s (0: not at all) for the
        first.
        """

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram; a failure is counted, never raised."""

    def close(self) -> None:
        """Give everything back; further calls do nothing."""


def parse_address(text: str, default_host: str = "") -> Address:
    """`HOST:PORT` or `PORT` -> (host, port); TransportError for anything else."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit()) or int(port) > 65535:
        raise TransportError(f"'{text}' is not an address: give HOST:PORT or PORT, PORT 0 to 65535")
    return host or default_host, int(port)
