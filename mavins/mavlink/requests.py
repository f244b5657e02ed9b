"""What peers ask of us, and the answers. State-changing requests are taken from this host only."""

from __future__ import annotations

import math
from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from mavins import __version__
from mavins.mavlink.codec import (
    Frames,
    Payload,
    attitude_from,
    attitude_quaternion,
    autopilot_version,
    command_ack,
    global_position_from,
    gps_global_origin,
    local_position_ned,
    odometry,
)
from mavins.mavlink.streams import (
    ESTIMATOR_TYPE_GPS_INS,
    estimator_status_of,
    quality_of,
)
from mavins.mavlink.vehicle import Vehicle

SET_GPS_GLOBAL_ORIGIN: Final = 48
COMMANDS: Final = (75, 76)
"""COMMAND_INT and COMMAND_LONG."""
REQUEST_MESSAGE: Final = 512
_ACCEPTED: Final = 0
_TEMPORARILY_REJECTED: Final = 1
_UNSUPPORTED: Final = 3
_CAPABILITIES: Final = 0x2000 | 0x20000
"""MAVLINK2 and PARAM_ENCODE_C_CAST."""


def decode_packet(frames: Frames, i: int) -> Any | None:
    """A packet through pymavlink, for the messages that our own codec leaves to it; None if it refuses."""
    try:
        return dialect.MAVLink(None).decode(bytearray(frames.packet(i)))
    except dialect.MAVError:
        return None


def answer(message: Any, sender: tuple[int, int], vehicle: Vehicle) -> list[Payload]:
    """The acknowledgement of a command that was sent to us, and the message it asks for."""
    command = int(message.command)
    if command != REQUEST_MESSAGE:
        return [command_ack(command, _UNSUPPORTED, *sender)]
    wanted = int(message.param1) if math.isfinite(message.param1) else -1
    if wanted not in _REQUESTABLE:
        return [command_ack(command, _UNSUPPORTED, *sender)]
    payload = _requested(wanted, vehicle)
    if payload is None:
        return [command_ack(command, _TEMPORARILY_REJECTED, *sender)]
    return [command_ack(command, _ACCEPTED, *sender), payload]


_REQUESTABLE: Final = (1, 30, 31, 32, 33, 49, 148, 230, 242, 331)


def _requested(msgid: int, vehicle: Vehicle) -> Payload | None:
    """One message on request, or None while there is nothing to put into it."""
    estimator = vehicle.estimator
    if msgid == 148:
        major, minor, patch = (*(int(p) for p in __version__.split("+")[0].split(".")[:3]), 0, 0)[
            :3
        ]
        return autopilot_version(_CAPABILITIES, (major, minor, patch), vehicle.our_sysid)
    if msgid == 1:
        return vehicle.sys_status()
    solution = estimator.solution()
    if solution is None or estimator.frame is None or vehicle.home is None:
        return None
    home = vehicle.home
    made: dict[int, Payload] = {
        30: attitude_from(solution),
        31: attitude_quaternion(solution),
        32: local_position_ned(solution),
        33: global_position_from(solution, home.position.alt),
        49: gps_global_origin(estimator.frame.origin, solution.t_us),
        230: estimator_status_of(estimator, solution),
        242: home.message(solution.t_us),
        331: odometry(solution, ESTIMATOR_TYPE_GPS_INS, quality_of(solution)),
    }
    return made[msgid]
