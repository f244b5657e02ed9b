"""Small protocols that ground stations expect an answer to: PING, TIMESYNC, missions.

We have no missions. Who asks for them is told so at once; otherwise each ground station waits and asks
again. Source: the MAVLink developer guide; what clients do: docs/reference/clients.md.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from typing import Any, Final

from mavins.mavlink.codec import Payload, fields_of, payload
from mavins.mavlink.microservice import Reply, Request
from mavins.mavlink.vehicle import Vehicle

PING: Final = fields_of("PING")
TIMESYNC: Final = fields_of("TIMESYNC")
MISSION_REQUEST_LIST: Final = fields_of("MISSION_REQUEST_LIST")
MISSION_COUNT: Final = fields_of("MISSION_COUNT")
MISSION_ACK: Final = fields_of("MISSION_ACK")
MISSION_CLEAR_ALL: Final = fields_of("MISSION_CLEAR_ALL")
_MISSION_ITEMS: Final = tuple(
    fields_of(name).msgid for name in ("MISSION_REQUEST", "MISSION_REQUEST_INT")
)

_MISSION_ACCEPTED: Final = 0
_MISSION_UNSUPPORTED: Final = 3
_MISSION_INVALID_SEQUENCE: Final = 13


class SmallTalk:
    """The microservice of all of them."""

    msgids = frozenset(
        (
            PING.msgid,
            TIMESYNC.msgid,
            MISSION_REQUEST_LIST.msgid,
            MISSION_COUNT.msgid,
            MISSION_CLEAR_ALL.msgid,
            *_MISSION_ITEMS,
        )
    )

    def answer(self, request: Request, vehicle: Vehicle) -> Iterator[Reply]:
        """At most one message back to who asked."""
        message, msgid = request.message, request.message.get_msgId()
        answer: Payload | None = None
        if msgid == PING.msgid:
            answer = _ping(message, request.sender)
        elif msgid == TIMESYNC.msgid:
            answer = _timesync(message, request.now_us)
        else:
            answer = _mission(message, request.sender)
        if answer is not None:
            yield Reply(answer)

    def tick(self, now_us: int, vehicle: Vehicle) -> Iterable[tuple[Hashable, Payload]]:
        """Nothing is paced."""
        return ()


def _ping(message: Any, sender: tuple[int, int]) -> Payload | None:
    if message.target_system or message.target_component:
        return None  # an answer to a ping, not one
    return payload(
        PING,
        time_usec=message.time_usec,
        seq=message.seq,
        target_system=sender[0],
        target_component=sender[1],
    )


def _timesync(message: Any, now_us: int) -> Payload | None:
    """Our time for theirs; tc1 = 0 marks a request."""
    return None if message.tc1 else payload(TIMESYNC, tc1=now_us * 1000, ts1=message.ts1)


def _mission(message: Any, sender: tuple[int, int]) -> Payload:
    """Every list is empty; none can be written."""
    target = {"target_system": sender[0], "target_component": sender[1]}
    kind = getattr(message, "mission_type", 0)
    msgid = message.get_msgId()
    if msgid == MISSION_REQUEST_LIST.msgid:
        return payload(MISSION_COUNT, count=0, mission_type=kind, **target)
    result = _MISSION_UNSUPPORTED
    if msgid in _MISSION_ITEMS:
        result = _MISSION_INVALID_SEQUENCE
    elif msgid == MISSION_CLEAR_ALL.msgid:
        result = _MISSION_ACCEPTED
    return payload(MISSION_ACK, type=result, mission_type=kind, **target)
