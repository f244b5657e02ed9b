"""Limits on who may send and how much, sans I/O: microseconds and addresses are handed in.

A datagram is admitted or dropped before it is looked at, for about a microsecond. A vehicle's address has a bucket of
its own, so has each peer's; all others share one, so that a flood from ever new addresses leaves the known ones alone
and costs no more than one address could.
"""

from __future__ import annotations

import ipaddress
from collections import Counter, OrderedDict
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import Annotated, Final, TypeAlias

from annotated_types import Ge, Le

from mavins.documented import Doc
from mavins.mavlink.codec.framing import STX_V1, STX_V2

Network: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

PACKET_MIN: Final = 8
"""Bytes of the shortest packet: MAVLink 1 without a payload."""
PIECE: Final = 64
"""Bytes of a stream that count as a datagram: about a packet."""
REMEMBERED: Final = 1024
"""Hosts whose place on the allow-list is remembered."""

_Rate = Annotated[float, Ge(1), Le(1_000_000)]


@dataclass(frozen=True, slots=True)
class LimitSettings:
    """Who may send, and how much is looked at; a burst may be a second's worth."""

    allow: Annotated[
        tuple[str, ...],
        Doc("Networks that may send, such as 192.168.1.0/24; none: all. This host always may."),
    ] = ()
    vehicle_rate: Annotated[
        _Rate, Doc("Of each vehicle; 64 bytes of a stream count as a datagram.", "datagrams/s")
    ] = 20_000.0
    peer_rate: Annotated[_Rate, Doc("Of each other peer.", "datagrams/s")] = 1000.0
    unknown_rate: Annotated[_Rate, Doc("Of all unknown addresses together.", "datagrams/s")] = 500.0

    def __post_init__(self) -> None:
        networks(self.allow)


def networks(texts: Iterable[str]) -> tuple[Network, ...]:
    """The networks of an allow-list; ValueError, in one line, for what is none."""
    found = []
    for text in texts:
        try:
            found.append(ipaddress.ip_network(text))
        except ValueError:
            raise ValueError(_no_network(text)) from None
    return tuple(found)


def _no_network(text: str) -> str:
    """Why a text is no network, with the network that was probably meant."""
    try:
        meant = ipaddress.ip_network(text, strict=False)
    except ValueError:
        return f"'{text}' is not a network: give ADDRESS or ADDRESS/BITS, as 192.168.1.0/24"
    return f"'{text}' has host bits set: did you mean {meant}?"


def is_loopback(host: str) -> bool:
    """True for an IP address of this host's loopback; a name is none."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def may_change(host: str, allow_remote: bool, signed: bool = False) -> bool:
    """Whether a request from `host` may change our state: from this host, if signed, or if all may."""
    return allow_remote or signed or is_loopback(host)


class AllowList:
    """The hosts of some networks, and loopback; with no network at all, everyone."""

    def __init__(self, allowed: Iterable[Network]) -> None:
        self._networks = tuple(allowed)
        self._known: OrderedDict[str, bool] = OrderedDict()

    def __contains__(self, host: str) -> bool:
        if not self._networks:
            return True
        known = self._known.get(host)
        if known is None:
            known = self._known[host] = is_loopback(host) or self._is_listed(host)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        return known

    def _is_listed(self, host: str) -> bool:
        try:
            address = ipaddress.ip_address(host.partition("%")[0])
        except ValueError:
            return False
        mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
        return any((mapped or address) in network for network in self._networks)


class Bucket:
    """A token bucket in integers: `rate` tokens a second, at most a second's worth of them."""

    __slots__ = ("_at_us", "_full", "_level", "_rate")

    def __init__(self, rate: float, now_us: int) -> None:
        self._rate = max(1, round(rate))  # micro-tokens per microsecond
        self._full = self._rate * 1_000_000
        self._level = self._full
        self._at_us = now_us

    def take(self, now_us: int, tokens: int = 1) -> bool:
        """Take tokens, if there are so many; a clock that steps back gives none."""
        if now_us > self._at_us:
            self._level = min(self._full, self._level + (now_us - self._at_us) * self._rate)
            self._at_us = now_us
        if self._level < tokens * 1_000_000:
            return False
        self._level -= tokens * 1_000_000
        return True


class Gate:
    """Admits datagrams. `dropped` counts the others by reason.

    The session says who is a vehicle and who a peer; it bounds their number. Nothing is kept of an unknown address.
    """

    def __init__(self, settings: LimitSettings, now_us: int) -> None:
        self.dropped: Counter[str] = Counter()
        self._settings = settings
        self._allowed = AllowList(networks(settings.allow))
        self._vehicles: dict[Hashable, Bucket] = {}
        self._peers: dict[Hashable, Bucket] = {}
        self._unknown = Bucket(settings.unknown_rate, now_us)

    def know(self, vehicles: Iterable[Hashable], peers: Iterable[Hashable], now_us: int) -> None:
        """Who is known from now on: the addresses that hold a vehicle, and all that we send to."""
        rates = self._settings.vehicle_rate, self._settings.peer_rate
        self._vehicles = _buckets(self._vehicles, vehicles, rates[0], now_us)
        self._peers = _buckets(self._peers, peers, rates[1], now_us)

    def admits(self, data: bytes, address: Hashable, host: str, now_us: int) -> bool:
        """True for a datagram that shall be scanned."""
        bucket, reason = self._bucket(address)
        if bucket is self._unknown:
            if not starts_a_packet(data):
                self.dropped["no packet from an unknown address"] += 1
                return False
            if host not in self._allowed:
                self.dropped["address not on the allow-list"] += 1
                return False
        if bucket.take(now_us):
            return True
        self.dropped[reason] += 1
        return False

    def admits_piece(self, data: bytes, address: Hashable, now_us: int) -> bool:
        """True for a piece of a stream that shall be scanned; the link asked who may connect."""
        bucket, reason = self._bucket(address)
        if bucket.take(now_us, -(-len(data) // PIECE)):
            return True
        self.dropped[reason] += 1
        return False

    def _bucket(self, address: Hashable) -> tuple[Bucket, str]:
        """Whose allowance an address uses, and what is said when there is none left."""
        if (bucket := self._vehicles.get(address)) is not None:
            return bucket, "vehicle over its rate"
        if (bucket := self._peers.get(address)) is not None:
            return bucket, "peer over its rate"
        return self._unknown, "unknown addresses over their rate"


def _buckets(
    before: dict[Hashable, Bucket], addresses: Iterable[Hashable], rate: float, now_us: int
) -> dict[Hashable, Bucket]:
    return {a: before.get(a) or Bucket(rate, now_us) for a in addresses}


def starts_a_packet(data: bytes) -> bool:
    """Whether a datagram begins like a packet: a start byte, and as long as its header says."""
    if len(data) < PACKET_MIN:
        return False
    if data[0] == STX_V2:
        return len(data) >= 12 + data[1]
    return data[0] == STX_V1 and len(data) >= 8 + data[1]
