"""Who asks for what we do not have is told so at once."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import frame, scan
from mavins.mavlink.microservice import Request
from mavins.mavlink.requests import decode_packet
from mavins.mavlink.small_talk import SmallTalk

NOW_US = 1_790_000_000_000_000


def talk(message: Any) -> list[Any]:
    heard = decode_packet(scan(message.pack(dialect.MAVLink(None, 255, 190))), 0)
    assert heard.get_msgId() in SmallTalk.msgids
    request = Request(heard, (255, 190), "here", False, NOW_US)
    vehicle: Any = None  # these answers are the same for every vehicle
    link = dialect.MAVLink(None)
    return [
        link.decode(bytearray(frame(reply.payload, 100, 1, 0)))
        for reply in SmallTalk().answer(request, vehicle)
    ]


def test_a_ping_comes_back_and_an_answer_does_not() -> None:
    (answer,) = talk(dialect.MAVLink_ping_message(123456, 7, 0, 0))
    assert (answer.time_usec, answer.seq) == (123456, 7)
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert talk(dialect.MAVLink_ping_message(123456, 7, 100, 1)) == []


def test_our_time_for_theirs() -> None:
    (answer,) = talk(dialect.MAVLink_timesync_message(0, 987654321))
    assert (answer.tc1, answer.ts1) == (NOW_US * 1000, 987654321)
    assert talk(dialect.MAVLink_timesync_message(5, 987654321)) == []


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_lists_are_empty_and_cannot_be_written(kind: int) -> None:
    (answer,) = talk(dialect.MAVLink_mission_request_list_message(100, 1, kind))
    assert (answer.get_type(), answer.count, answer.mission_type) == ("MISSION_COUNT", 0, kind)
    for message, result in (
        (dialect.MAVLink_mission_count_message(100, 1, 5, kind), 3),
        (dialect.MAVLink_mission_request_int_message(100, 1, 0, kind), 13),
        (dialect.MAVLink_mission_clear_all_message(100, 1, kind), 0),
    ):
        (answer,) = talk(message)
        assert (answer.get_type(), answer.type) == ("MISSION_ACK", result)
        assert answer.mission_type == kind
