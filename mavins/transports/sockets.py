"""Sockets of either family of IP, with errors that say the way out."""

from __future__ import annotations

import errno
import socket

from mavins.errors import TransportError
from mavins.transports.base import Address, address_text

_PROTOCOLS = {socket.SOCK_DGRAM: "udp", socket.SOCK_STREAM: "tcp"}


def family_of(host: str) -> socket.AddressFamily:
    """The family of a numeric address."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def resolve(host: str, port: int = 0) -> Address:
    """The numeric address of a host name, IPv4 where it has one; TransportError where it has none."""
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            found = socket.getaddrinfo(host, port, family, socket.SOCK_DGRAM)
        except (OSError, UnicodeError, OverflowError, ValueError):
            continue
        address = found[0][4]
        return str(address[0]), int(address[1])
    raise TransportError(f"no host is called '{host}'")


def bound(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """A socket at a port (0: any free one); an empty host means all IPv4 interfaces, `::` those of
    IPv6 too.
    """
    numeric = resolve(host)[0] if host else ""
    sock = socket.socket(family_of(numeric), kind)
    try:
        if kind == socket.SOCK_STREAM:
            # a service that is started again need not wait for the connections of the last one
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sock.family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, int(numeric != "::"))
        sock.bind((numeric, port))
    except OSError as error:
        sock.close()
        raise TransportError(_why(_PROTOCOLS[kind], host, port, error)) from error
    return sock


def _why(protocol: str, host: str, port: int, error: OSError) -> str:
    where = f"{protocol} {address_text((host or '0.0.0.0', port))}"
    if error.errno == errno.EADDRINUSE and protocol == "tcp":
        return f"{where} is in use by another program: take another port"
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
