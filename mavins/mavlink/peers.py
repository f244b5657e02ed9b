"""Who receives what we send: addresses, how long they have been silent, and the packet counters of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple


class Identity(NamedTuple):
    """Under which ids somebody speaks."""

    sysid: int
    compid: int


@dataclass(slots=True)
class Peer:
    """An address that receives our streams. `seen_us` None: one that was named by the user and never expires.

    `warned` says whether it was told that it may not change our state. Sequence numbers are counted for each peer
    apart: with one counter for all, each would take what went to the others for lost.
    """

    seen_us: int | None
    warned: bool = False
    sequence: dict[Identity, int] = field(default_factory=dict)

    def next_sequence(self, who: Identity) -> int:
        """The number of the next packet of one of our identities to this peer."""
        number = self.sequence.get(who, 0)
        self.sequence[who] = (number + 1) % 256
        return number


class Peers:
    """All peers, at most `limit` of them beside those that the user named; `dropped` counts who is turned away."""

    def __init__(self, limit: int, timeout_us: int, dropped: Counter[str]) -> None:
        self._dropped = dropped
        self._limit = limit
        self._timeout_us = timeout_us
        self._peers: dict[Hashable, Peer] = {}

    def __len__(self) -> int:
        """How many there are."""
        return len(self._peers)

    def __iter__(self) -> Iterator[Hashable]:
        """Their addresses."""
        return iter(self._peers)

    def get(self, address: Hashable) -> Peer | None:
        """The peer at an address."""
        return self._peers.get(address)

    def items(self) -> list[tuple[Hashable, Peer]]:
        """Addresses and peers."""
        return list(self._peers.items())

    def name(self, address: Hashable) -> None:
        """A peer that receives without having sent."""
        self._peers[address] = Peer(None)

    def see(self, address: Hashable, now_us: int) -> bool:
        """Somebody sent a valid packet; True for a new peer."""
        peer = self._peers.get(address)
        if peer is not None:
            if peer.seen_us is not None:
                peer.seen_us = now_us
            return False
        if len(self._peers) >= self._limit:
            self._dropped["more peers than max_peers"] += 1
            return False
        self._peers[address] = Peer(now_us)
        return True

    def drop(self, address: Hashable) -> bool:
        """Forget a peer whose connection ended, unless it was named; True if it is gone."""
        peer = self._peers.get(address)
        if peer is None or peer.seen_us is None:
            return False
        del self._peers[address]
        return True

    def expire(self, now_us: int) -> list[Hashable]:
        """Forget those that have been silent for too long; returns their addresses."""
        gone = [
            address
            for address, peer in self._peers.items()
            if peer.seen_us is not None and now_us - peer.seen_us > self._timeout_us
        ]
        for address in gone:
            del self._peers[address]
        return gone
