"""REQUEST_DATA_STREAM, the forerunner of SET_MESSAGE_INTERVAL, which MAVProxy still sends: rates for whole groups."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Final

from mavins.mavlink.vehicle import Vehicle

REQUEST_DATA_STREAM: Final = 66
_ALL: Final = 0
_GROUPS: Final = {
    1: ("highres_imu",),
    2: ("sys_status", "extended_sys_state"),
    6: ("local_position_ned", "global_position_int", "odometry"),
    10: ("attitude", "attitude_quaternion"),
    12: ("estimator_status", "vibration", "system_time", "home_position"),
}
"""MAV_DATA_STREAM -> our messages in it."""


def set_data_stream(message: Any, vehicle: Vehicle, address: Hashable) -> None:
    """Send a group to this peer at the wanted rate, or not at all; groups of which we have nothing mean nothing.

    A request for all concerns what the peer gets now: it does not turn on what is off.
    """
    rate = int(message.req_message_rate) if message.start_stop else 0
    stream = int(message.req_stream_id)
    names = (
        vehicle.sent_to(address)
        if stream == _ALL and rate > 0
        else [n for group in _GROUPS.values() for n in group]
        if stream == _ALL
        else _GROUPS.get(stream, ())
    )
    for name in names:
        vehicle.set_interval(address, name, round(1e6 / min(rate, 1000)) if rate > 0 else -1)
