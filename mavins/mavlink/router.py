"""Forwards packets between peers, so that one link of an autopilot can serve a ground station and us.

A packet without a target, or for every system, goes to all other peers; one with a target goes where that system, or
that component of it, was heard. Nothing goes back to where it came from, nothing is changed, and what we cannot check
(a message that the dialect lacks) is not passed on. Source: the MAVLink developer guide, routing.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterable, Iterator
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Frames, fields_of
from mavins.mavlink.peers import Identity

REMEMBERED: Final = 1024
"""Components whose addresses are kept; a flood of made-up ones pushes out the one heard longest ago."""
_PRIVATE: Final = frozenset((fields_of("SETUP_SIGNING").msgid,))
"""Holds a key."""


def _target_offsets() -> dict[int, tuple[int, int | None]]:
    """Message id -> where in the payload the target's sysid and compid are."""
    offsets: dict[int, tuple[int, int | None]] = {}
    for msgid, message in dialect.mavlink_map.items():
        dtype = fields_of(message.msgname).dtype
        if dtype.fields is not None and "target_system" in dtype.fields:
            component = dtype.fields.get("target_component")
            offsets[msgid] = (
                dtype.fields["target_system"][1],
                None if component is None else component[1],
            )
    return offsets


class Router:
    """Knows who was heard where."""

    def __init__(self) -> None:
        self._offsets = _target_offsets()
        self._heard: OrderedDict[Identity, set[Hashable]] = OrderedDict()

    def hear(self, frames: Frames, address: Hashable) -> None:
        """Note who speaks from an address."""
        ids = zip(frames.sysid.tolist(), frames.compid.tolist(), strict=True)
        for who in {Identity(*pair) for pair in ids}:
            self._heard.setdefault(who, set()).add(address)
            self._heard.move_to_end(who)
        while len(self._heard) > REMEMBERED:
            self._heard.popitem(last=False)

    def forget(self, address: Hashable) -> None:
        """A peer has gone."""
        for addresses in self._heard.values():
            addresses.discard(address)

    def forward(
        self, frames: Frames, source: Hashable, peers: Iterable[Hashable]
    ) -> Iterator[tuple[bytes, Hashable]]:
        """What goes where: (packet, address)."""
        others = [address for address in peers if address != source]
        for i in range(len(frames)):
            msgid = int(frames.msgid[i])
            if msgid in _PRIVATE:
                continue
            target = self._target(frames, i, msgid)
            for address in others if target is None else self._where(target, others):
                yield frames.packet(i), address

    def _target(self, frames: Frames, i: int, msgid: int) -> Identity | None:
        """Whom a packet is for; None for everybody."""
        if msgid not in self._offsets:
            return None
        at_system, at_component = self._offsets[msgid]
        body = frames.body(i, max(at_system, at_component or 0) + 1)
        target = Identity(body[at_system], 0 if at_component is None else body[at_component])
        return target if target.sysid else None

    def _where(self, target: Identity, others: list[Hashable]) -> list[Hashable]:
        found = {
            address
            for who, addresses in self._heard.items()
            if who.sysid == target.sysid and target.compid in (0, who.compid)
            for address in addresses
        }
        return [address for address in others if address in found]
