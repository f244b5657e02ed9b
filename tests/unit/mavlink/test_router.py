"""Who gets what of others' packets."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Frames, frame, heartbeat, scan
from mavins.mavlink.router import REMEMBERED, Router

AUTOPILOT, STATION, GIMBAL = "autopilot", "station", "gimbal"
PEERS = (AUTOPILOT, STATION, GIMBAL)


def packed(message: Any, sysid: int = 255, compid: int = 190) -> Frames:
    return scan(bytes(message.pack(dialect.MAVLink(None, sysid, compid))))


def beat(sysid: int, compid: int) -> Frames:
    return scan(frame(heartbeat(2, 3), sysid, compid, 0))


def order(sysid: int, compid: int) -> Frames:
    return packed(dialect.MAVLink_command_long_message(sysid, compid, 400, 0, 1, 0, 0, 0, 0, 0, 0))


def router() -> Router:
    made = Router()
    made.hear(beat(1, 1), AUTOPILOT)
    made.hear(beat(1, 154), GIMBAL)
    made.hear(beat(255, 190), STATION)
    return made


def receivers(made: Router, frames: Frames, source: str) -> list[Any]:
    return [address for _, address in made.forward(frames, source, PEERS)]


def test_what_has_no_target_goes_to_all_others_unchanged() -> None:
    frames = beat(1, 1)
    sent = list(router().forward(frames, AUTOPILOT, PEERS))
    assert sent == [(frames.packet(0), STATION), (frames.packet(0), GIMBAL)]


def test_what_has_a_target_goes_where_it_was_heard() -> None:
    assert receivers(router(), order(1, 1), STATION) == [AUTOPILOT]
    assert receivers(router(), order(1, 154), STATION) == [GIMBAL]
    assert receivers(router(), order(1, 0), STATION) == [AUTOPILOT, GIMBAL]
    assert receivers(router(), order(0, 0), STATION) == [AUTOPILOT, GIMBAL]
    assert receivers(router(), order(77, 1), STATION) == []


def test_nothing_goes_back_to_where_it_came_from() -> None:
    assert receivers(router(), order(255, 190), STATION) == []
    assert receivers(router(), order(1, 1), AUTOPILOT) == []


def test_a_key_is_never_passed_on() -> None:
    setup = dialect.MAVLink_setup_signing_message(1, 1, [7] * 32, 1)
    assert receivers(router(), packed(setup), STATION) == []


def test_who_has_gone_receives_nothing_more() -> None:
    made = router()
    made.forget(GIMBAL)
    assert receivers(made, order(1, 154), STATION) == []


def test_made_up_components_do_not_grow_memory() -> None:
    made = router()
    for sysid in range(1, 256):
        for compid in range(1, 11):
            made.hear(beat(sysid, compid), STATION)
    assert len(made._heard) == REMEMBERED


def test_a_short_payload_means_target_zero() -> None:
    # MAVLink 2 cuts trailing zeros off: a target beyond the payload is everybody
    frames = packed(dialect.MAVLink_mission_request_list_message(0, 0, 0))
    assert len(receivers(router(), frames, STATION)) == 2
