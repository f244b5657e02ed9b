"""What every transport does: datagrams in, datagrams out; the other side cannot make it raise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Final, Protocol, TypeAlias

from mavins.errors import TransportError

Address: TypeAlias = tuple[str, int]
"""A host and a port; of a serial line the device and 0."""
Datagram: TypeAlias = tuple[bytes, Address]
"""Bytes and where they came from."""
Say: TypeAlias = Callable[[str], None]
"""Takes one line about a link for people."""
Admits: TypeAlias = Callable[[str], bool]
"""Whether a host may send to a link at all."""
NOT_ADMITTED: Final = "address not on the allow-list"


def everyone(host: str) -> bool:
    """Admits every host."""
    return True


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


class Link(Transport, Protocol):
    """A transport that the service can wait for, and what it must know of it."""

    @property
    def announcement(self) -> str:
        """One line for people: what was opened and where."""

    @property
    def is_stream(self) -> bool:
        """True where `recv` gives pieces of a stream, an empty piece at its end."""

    @property
    def trusted(self) -> bool:
        """True where whoever is at the other end may do what a program of this host may."""

    @property
    def peers(self) -> Sequence[Address]:
        """Who receives without having sent."""

    @property
    def dropped(self) -> Counter[str]:
        """What was not sent or broke, counted by reason."""

    def fileno(self) -> int:
        """A descriptor that is readable when `recv` has something to do, the same one for life."""

    def prefer(self, peers: Collection[Address]) -> None:
        """Whose data shall not wait behind that of all others, where that can be had."""

    def tick(self) -> None:
        """What is due by the clock, such as another attempt to connect; some ten times a second."""


def parse_address(text: str, default_host: str = "") -> Address:
    """`HOST:PORT`, `[IPV6]:PORT` or `PORT` -> (host, port); TransportError for anything else."""
    host, _, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        raise TransportError(
            f"'{text}' is not an address: give HOST:PORT; IPv6 in brackets, as in [::1]:14550"
        )
    if not (port.isascii() and port.isdigit()) or int(port) > 65535:
        raise TransportError(f"'{text}' is not an address: give HOST:PORT or PORT, PORT 0 to 65535")
    return host or default_host, int(port)


def address_text(address: Address) -> str:
    """The inverse of `parse_address`."""
    host, port = address
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
