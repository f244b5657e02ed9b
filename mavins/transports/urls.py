"""The URL of a link: what `--link` takes."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias
from urllib.parse import parse_qsl

from mavins.errors import TransportError
from mavins.transports.base import parse_address

EXAMPLES: Final = {
    "udp": "udp://:14550",
    "udpout": "udpout://192.168.1.20:14550",
    "udpmcast": "udpmcast://239.255.145.50:14550",
    "tcp": "tcp://127.0.0.1:5760",
    "tcpin": "tcpin://:5760",
    "serial": "serial:///dev/ttyAMA0?baud=921600",
}
"""Every kind of link, and what its URL looks like."""

Unsigned: TypeAlias = Literal["none", "local", "all"]
POLICIES: Final[dict[str, Unsigned]] = {"none": "none", "local": "local", "all": "all"}
OPTIONS: Final = {"serial": ("baud", "trusted"), "udpmcast": ("interface",)}
"""Beside `unsigned`, which every kind has."""
DEFAULT_BAUD: Final = 57600
MAX_BAUD: Final = 4_000_000


@dataclass(frozen=True, slots=True)
class LinkUrl:
    """One link as the user named it; an empty `host` means all interfaces (tcp, udpout: this host).

    `device`, `baud` and `trusted` are a serial line's, `interface` is the IPv4 address of the
    interface for multicast. `unsigned` says whose packets are taken without a signature where there
    is a key: None: as configured.
    """

    kind: str
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = DEFAULT_BAUD
    trusted: bool = False
    interface: str = ""
    unsigned: Unsigned | None = None


def parse_url(text: str) -> LinkUrl:
    """The link that a URL names; TransportError, with an example, for what is none."""
    kind, separator, rest = text.partition("://")
    if not separator or kind not in EXAMPLES:
        raise TransportError(
            f"'{text}' is not a link: it begins with {', '.join(f'{k}://' for k in EXAMPLES)}, "
            f"for example {EXAMPLES['udp']} or {EXAMPLES['serial']}"
        )
    place, _, query = rest.partition("?")
    options = _options(text, kind, query)
    unsigned = options.pop("unsigned", None)
    if unsigned is not None and unsigned not in POLICIES:
        raise _wrong(text, kind, "unsigned is none, local or all")
    link = _link(text, kind, place, options)
    return link if unsigned is None else replace(link, unsigned=POLICIES[unsigned])


def _link(text: str, kind: str, place: str, options: dict[str, str]) -> LinkUrl:
    if kind == "serial":
        return _serial(text, place, options)
    try:
        host, port = parse_address(place.removesuffix("/"))
    except TransportError:
        raise _wrong(text, kind, "an address is HOST:PORT, or [IPV6]:PORT") from None
    if kind in ("tcp", "udpout", "udpmcast") and not port:
        raise _wrong(text, kind, "name the port of the other side")
    if kind == "udpmcast":
        return _multicast(text, host, port, options)
    return LinkUrl(kind, host, port)


def _serial(text: str, device: str, options: dict[str, str]) -> LinkUrl:
    if not device.startswith("/") or "\0" in device:
        raise _wrong(text, "serial", "name the device by its full path, after three slashes")
    baud = options.get("baud", str(DEFAULT_BAUD))
    if not (baud.isascii() and baud.isdigit() and 0 < int(baud) <= MAX_BAUD):
        raise _wrong(text, "serial", f"baud is a number up to {MAX_BAUD}")
    trusted = options.get("trusted", "0")
    if trusted not in ("0", "1"):
        raise _wrong(text, "serial", "trusted is 1 or 0")
    return LinkUrl("serial", device=device, baud=int(baud), trusted=trusted == "1")


def _multicast(text: str, host: str, port: int, options: dict[str, str]) -> LinkUrl:
    interface = options.get("interface", "")
    try:
        is_group = ipaddress.IPv4Address(host).is_multicast
        if interface:
            ipaddress.IPv4Address(interface)
    except ValueError:
        is_group = False
    if not is_group:
        raise _wrong(
            text, "udpmcast", "the group is 224.0.0.0 to 239.255.255.255, interface an IPv4 address"
        )
    return LinkUrl("udpmcast", host, port, interface=interface)


def _options(text: str, kind: str, query: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
    except ValueError:
        raise _wrong(text, kind, "options are ?NAME=VALUE&NAME=VALUE") from None
    known = (*OPTIONS.get(kind, ()), "unsigned")
    for name, _ in pairs:
        if name not in known:
            raise _wrong(text, kind, f"it has no option '{name}', only {', '.join(known)}")
    return dict(pairs)


def _wrong(text: str, kind: str, why: str) -> TransportError:
    return TransportError(f"link '{text}': {why}, for example {EXAMPLES[kind]}")
