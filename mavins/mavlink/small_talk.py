"""Small protocols that ground stations expect an answer to: PING, TIMESYNC, file transfer, missions.

We have no files and no missions. Who asks for them is told so at once; otherwise each ground station waits and asks
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
FTP: Final = fields_of("FILE_TRANSFER_PROTOCOL")
MISSION_REQUEST_LIST: Final = fields_of("MISSION_REQUEST_LIST")
MISSION_COUNT: Final = fields_of("MISSION_COUNT")
MISSION_ACK: Final = fields_of("MISSION_ACK")
MISSION_CLEAR_ALL: Final = fields_of("MISSION_CLEAR_ALL")
_MISSION_ITEMS: Final = tuple(
    fields_of(name).msgid for name in ("MISSION_REQUEST", "MISSION_REQUEST_INT")
)

_NAK: Final = 129
_FILE_NOT_FOUND: Final = 10
_MISSION_ACCEPTED: Final = 0
_MISSION_UNSUPPORTED: Final = 3
_MISSION_INVALID_SEQUENCE: Final = 13


class SmallTalk:
    """The microservice of all of them."""

    msgids = frozenset(
        (
            PING.msgid,
            TIMESYNC.msgid,
            FTP.msgid,
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
        elif msgid == FTP.msgid:
            answer = _refuse_file(message, request.sender)
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


def _refuse_file(message: Any, sender: tuple[int, int]) -> Payload | None:
    """NAK of whatever was asked: there is no such file.

    The header of a request: sequence (2), session (1), opcode (1), size (1), opcode answered (1), burst (1), padding
    (1), offset (4), data.
    """
    asked = bytes(message.payload)
    opcode = asked[3]
    if opcode >= 128:
        return None  # an answer
    sequence = (int.from_bytes(asked[:2], "little") + 1) % 65536
    header = sequence.to_bytes(2, "little") + bytes((asked[2], _NAK, 1, opcode, 0, 0)) + asked[8:12]
    body = (header + bytes((_FILE_NOT_FOUND,))).ljust(251, b"\0")
    return payload(FTP, target_system=sender[0], target_component=sender[1], payload=tuple(body))


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
