"""The command protocol: every command to us is acknowledged, the acknowledgement before what it asks for.

Source: the MAVLink developer guide, command protocol.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from mavins import __version__
from mavins.estimator.feed import Feed
from mavins.mavlink.codec import (
    Payload,
    autopilot_version,
    command_ack,
    message_interval,
)
from mavins.mavlink.codec.checks import MAX_ALTITUDE
from mavins.mavlink.codec.component_metadata import COMPONENT_METADATA, component_metadata
from mavins.mavlink.data_streams import REQUEST_DATA_STREAM, set_data_stream
from mavins.mavlink.files import GENERAL, crc32, files_of, uri
from mavins.mavlink.microservice import Reply, Request
from mavins.mavlink.parameters import ParameterStore, changes_since, values_of
from mavins.mavlink.streams import MSGIDS, Home
from mavins.mavlink.vehicle import Vehicle
from mavins.types import Origin

COMMAND_INT: Final = 75
COMMAND_LONG: Final = 76

SET_HOME: Final = 179
CALIBRATE: Final = 241
STORE_PARAMETERS: Final = 245
RESTART: Final = 246
GET_HOME: Final = 410
GET_INTERVAL: Final = 510
SET_INTERVAL: Final = 511
REQUEST_MESSAGE: Final = 512
REQUEST_VERSION: Final = 520
SET_GLOBAL_ORIGIN: Final = 611
CHANGING: Final = frozenset((SET_HOME, CALIBRATE, STORE_PARAMETERS, RESTART, SET_GLOBAL_ORIGIN))
"""Commands that change our state: taken from trusted peers only."""

ACCEPTED: Final = 0
TEMPORARILY_REJECTED: Final = 1
DENIED: Final = 2
UNSUPPORTED: Final = 3
FAILED: Final = 4
_WARNING: Final = 4
"""Of MAV_SEVERITY."""

_CAPABILITIES: Final = 0x8 | 0x20 | 0x2000 | 0x20000
"""COMMAND_INT, FTP, MAVLINK2 and PARAM_ENCODE_C_CAST."""
_AUTOPILOT_VERSION: Final = 148
_HOME_POSITION: Final = 242
_MESSAGE_INTERVAL: Final = 244
_SHORTEST_US: Final = 1000
_GLOBAL_FRAMES: Final = (0, 3, 5, 6, 10, 11)


@dataclass(frozen=True, slots=True)
class Command:
    """A command, whichever message it came in: its number and seven parameters; places in degrees."""

    number: int
    p: tuple[float, float, float, float, float, float, float]

    @classmethod
    def of(cls, message: Any) -> Command:
        """The command in a COMMAND_LONG or a COMMAND_INT."""
        first = (message.param1, message.param2, message.param3, message.param4)
        if message.get_msgId() == COMMAND_LONG:
            return cls(
                int(message.command), (*first, message.param5, message.param6, message.param7)
            )
        scale = 1e-7 if int(message.frame) in _GLOBAL_FRAMES else 1e-4
        return cls(int(message.command), (*first, message.x * scale, message.y * scale, message.z))

    def number_in(self, k: int) -> int:
        """Parameter k (from 1) as an integer; -1 where it is none."""
        value = self.p[k - 1]
        return int(value) if math.isfinite(value) and value == int(value) else -1

    @property
    def place(self) -> Origin | None:
        """Parameters 5 to 7 as a place on Earth, or None where they are none."""
        lat_deg, lon_deg, alt = self.p[4:]
        if not all(map(math.isfinite, self.p[4:])) or (lat_deg, lon_deg) == (0.0, 0.0):
            return None
        if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0 or abs(alt) > MAX_ALTITUDE:
            return None
        return Origin(math.radians(lat_deg), math.radians(lon_deg), alt)


def carry_out(command: Command, feed: Feed) -> bool:
    """What a command does to the estimate, live and again in a replay; False where it does nothing to it."""
    if command.number == SET_GLOBAL_ORIGIN and command.place is not None:
        feed.set_origin(command.place)
    elif command.number == CALIBRATE and command.number_in(1) == 1:
        return feed.calibrate("calibration asked for")
    elif command.number == RESTART and 1 in (command.number_in(1), command.number_in(2)):
        feed.restart("restart asked for")
    else:
        return False
    return True


def keep_parameters(command: Command, store: ParameterStore) -> str:
    """What STORE_PARAMETERS does, live and again in a replay; returns why it failed, or nothing."""
    action = command.number_in(1)
    if action == 1:
        return store.save()
    if action == 0:
        store.load()
    elif action == 2:
        store.reset()
    else:
        return "parameters can be loaded (0), saved (1) and reset (2)"
    return ""


Answer = tuple[int, list[Payload]]
"""A MAV_RESULT, and what follows the acknowledgement."""


class Commands:
    """The microservice of commands and of their forerunner REQUEST_DATA_STREAM."""

    msgids = frozenset((COMMAND_INT, COMMAND_LONG, REQUEST_DATA_STREAM))

    def answer(self, request: Request, vehicle: Vehicle) -> Iterator[Reply]:
        """The acknowledgement and what the command asks for."""
        if request.message.get_msgId() == REQUEST_DATA_STREAM:
            set_data_stream(request.message, vehicle, request.address)
            return
        command = Command.of(request.message)
        if command.number in CHANGING and not request.trusted:
            result, payloads = DENIED, list[Payload]()
        else:
            handler = HANDLERS.get(command.number)
            result, payloads = (
                (UNSUPPORTED, []) if handler is None else handler(command, vehicle, request.address)
            )
        yield Reply(command_ack(command.number, result, *request.sender))
        for payload in payloads:
            # what has changed concerns everybody
            yield Reply(payload, to_all=command.number in CHANGING)

    def tick(self, now_us: int, vehicle: Vehicle) -> Iterable[tuple[Hashable, Payload]]:
        """Nothing is paced."""
        return ()


def _request_message(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    return _message(command.number_in(1), vehicle, address, command)


def _message(msgid: int, vehicle: Vehicle, address: Hashable, command: Command) -> Answer:
    """One message, now."""
    if msgid == _AUTOPILOT_VERSION:
        major, minor, patch, *_ = (*(int(p) for p in __version__.split("+")[0].split(".")), 0, 0)
        version = (major, minor, patch)
        return ACCEPTED, [autopilot_version(_CAPABILITIES, version, vehicle.identity.sysid)]
    if msgid == _MESSAGE_INTERVAL:
        return _interval(command.number_in(2), vehicle, address)
    if msgid == COMPONENT_METADATA:
        return _metadata(vehicle)
    name = MSGIDS.get(msgid)
    if name is None:
        return UNSUPPORTED, []
    payload = vehicle.telemetry()[name]
    return (TEMPORARILY_REJECTED, []) if payload is None else (ACCEPTED, [payload])


def _metadata(vehicle: Vehicle) -> Answer:
    """Where the description of the parameters begins."""
    general = files_of(vehicle.parameters.store.described()).get(GENERAL)
    if general is None:
        return UNSUPPORTED, []
    t_us = vehicle.estimator.t_us or 0
    return ACCEPTED, [component_metadata(t_us, crc32(general), uri(GENERAL))]


def _set_interval(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    """-1 turns a message off, 0 gives it its usual rate; for this peer alone."""
    name, interval = MSGIDS.get(command.number_in(1)), command.number_in(2)
    if name is None:
        return UNSUPPORTED, []
    if command.p[1] != interval or interval < -1 or 0 < interval < _SHORTEST_US:
        return DENIED, []
    vehicle.set_interval(address, name, None if interval == 0 else interval)
    return ACCEPTED, []


def _get_interval(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    return _interval(command.number_in(1), vehicle, address)


def _interval(msgid: int, vehicle: Vehicle, address: Hashable) -> Answer:
    name = MSGIDS.get(msgid)
    if name is None:
        # the answer to an unknown message is defined: an interval of 0
        return ACCEPTED, [message_interval(max(msgid, 0), 0)]
    return ACCEPTED, [message_interval(msgid, vehicle.interval_us(address, name))]


def _get_home(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    return _message(_HOME_POSITION, vehicle, address, command)


def _version(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    return _message(_AUTOPILOT_VERSION, vehicle, address, command)


def _set_global_origin(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    place = command.place
    return (DENIED, []) if place is None else (ACCEPTED, vehicle.set_origin(place))


def _set_home(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    """Home is here, or at a place."""
    solution, frame = vehicle.estimator.solution(), vehicle.estimator.frame
    here = command.number_in(1) == 1
    if not here and command.place is None:
        return DENIED, []
    if solution is None or frame is None:
        return TEMPORARILY_REJECTED, []
    if here:
        vehicle.home = Home.at(solution)
    else:
        assert command.place is not None
        vehicle.home = Home.of(command.place, frame)
    return ACCEPTED, [vehicle.home.message(solution.t_us)]


def _calibrate(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    """The gyro's biases and the alignment anew; not in flight."""
    if command.number_in(1) != 1:
        return UNSUPPORTED, []
    if not carry_out(command, vehicle.estimator):
        return TEMPORARILY_REJECTED, []
    return ACCEPTED, vehicle.news()


def _keep_parameters(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    store = vehicle.parameters.store
    before = values_of(store)
    if reason := keep_parameters(command, store):
        return FAILED, vehicle.text(f"mavins: {reason}", _WARNING)
    return ACCEPTED, changes_since(before, store)


def _restart(command: Command, vehicle: Vehicle, address: Hashable) -> Answer:
    return (ACCEPTED, vehicle.news()) if carry_out(command, vehicle.estimator) else (DENIED, [])


HANDLERS: Final[dict[int, Callable[[Command, Vehicle, Hashable], Answer]]] = {
    SET_HOME: _set_home,
    CALIBRATE: _calibrate,
    STORE_PARAMETERS: _keep_parameters,
    RESTART: _restart,
    GET_HOME: _get_home,
    GET_INTERVAL: _get_interval,
    SET_INTERVAL: _set_interval,
    REQUEST_MESSAGE: _request_message,
    REQUEST_VERSION: _version,
    SET_GLOBAL_ORIGIN: _set_global_origin,
}
