"""What the simulated autopilot answers: which messages it sends how often, and its time.

SET_MESSAGE_INTERVAL (511) changes the rates: a sensor gives no more than its own, so a shorter interval is denied. A
longer one leaves samples out, as autopilots do. REQUEST_MESSAGE (512) sends the next sample of a message that may be
off, AUTOPILOT_VERSION at once. TIMESYNC is answered with boot time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any, Final, Literal, TypeAlias

from annotated_types import Ge, Le
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Payload, fields_of
from mavins.mavlink.codec.encode import payload
from mavins.mavlink.codec.outputs import autopilot_version, command_ack
from sitl.settings import Settings

Commands: TypeAlias = Literal["accept", "deny", "ignore"]
StreamRate: TypeAlias = Annotated[int, Ge(0), Le(1000)] | None

SET_INTERVAL: Final = 511
REQUEST_MESSAGE: Final = 512
REQUEST_VERSION: Final = 520
ACCEPTED: Final = 0
DENIED: Final = 2
UNSUPPORTED: Final = 3
_TIMESYNC: Final = fields_of("TIMESYNC")
_VERSION: Final = fields_of("AUTOPILOT_VERSION").msgid
_MAVLINK2: Final = 0x2000


@dataclass(frozen=True, slots=True)
class StreamSettings(Settings):
    """What is sent at the start, in Hz: 0 is off, null and whatever is faster is the sensor's own rate."""

    highres_imu: StreamRate = None
    attitude: StreamRate = None
    gps_raw_int: StreamRate = None
    global_position_int: StreamRate = None
    hil_state_quaternion: StreamRate = None
    system_time: StreamRate = None


class Streams:
    """Which packets are sent: of message m, one per interval of `interval_us[m]`; -1 is none, none given is all."""

    def __init__(self, settings: StreamSettings, own_us: dict[int, int]) -> None:
        self.own_us = own_us
        self._interval_us: dict[int, int] = {}
        self._slot: dict[int, int] = {}
        self._once: set[int] = set()
        for field in fields(settings):
            rate, msgid = getattr(settings, field.name), fields_of(field.name.upper()).msgid
            if rate == 0:
                self._interval_us[msgid] = -1
            elif rate is not None and 1_000_000 // rate > own_us[msgid]:
                self._interval_us[msgid] = 1_000_000 // rate

    def passes(self, msgid: int, t_us: int) -> bool:
        """True for a packet that is to be sent."""
        interval_us = self._interval_us.get(msgid)
        if msgid in self._once:
            self._once.discard(msgid)
            return True
        if interval_us is None:
            return True
        if interval_us < 0:
            return False
        before, self._slot[msgid] = self._slot.get(msgid), t_us // interval_us
        return before != self._slot[msgid]

    def set_interval(self, msgid: int, interval_us: float) -> int:
        """MAV_RESULT of SET_MESSAGE_INTERVAL: -1 is off, 0 the sensor's own rate."""
        own_us = self.own_us.get(msgid)
        if own_us is None:
            return UNSUPPORTED
        if interval_us == 0.0:
            self._interval_us.pop(msgid, None)
        elif interval_us == -1.0:
            self._interval_us[msgid] = -1
        elif math.isfinite(interval_us) and interval_us >= own_us:
            self._interval_us[msgid] = round(interval_us)
        else:
            return DENIED
        return ACCEPTED

    def once(self, msgid: int) -> bool:
        """Send the next packet of a message, whatever its interval; False for one that there is not."""
        if msgid in self.own_us:
            self._once.add(msgid)
        return msgid in self.own_us


class Answers:
    """Answers to datagrams, as autopilot (sysid, compid)."""

    def __init__(self, commands: Commands, streams: Streams, sysid: int, compid: int) -> None:
        self._commands = commands
        self._streams = streams
        self._who = (sysid, compid)

    def to(self, data: bytes, boot_us: int) -> Iterator[Payload]:
        """What is sent because of a datagram that came `boot_us` after boot."""
        if self._commands == "ignore":
            return
        parser = dialect.MAVLink(None)  # a new one: what is damaged must not spoil the next
        parser.robust_parsing = True
        for message in parser.parse_buffer(bytearray(data)) or ():
            kind = message.get_type()
            if kind in ("COMMAND_LONG", "COMMAND_INT") and self._is_meant(message):
                yield from self._command(message)
            elif kind == "TIMESYNC" and message.tc1 == 0:
                yield payload(_TIMESYNC, tc1=boot_us * 1000, ts1=message.ts1)

    def _is_meant(self, message: Any) -> bool:
        sysid, compid = self._who
        system, component = message.target_system, message.target_component
        return system in (0, sysid) and component in (0, compid)

    def _command(self, message: Any) -> Iterator[Payload]:
        version = False
        if self._commands == "deny":
            result = DENIED
        elif message.command == SET_INTERVAL:
            result = self._streams.set_interval(_whole(message.param1), message.param2)
        elif message.command in (REQUEST_MESSAGE, REQUEST_VERSION):
            asked = _whole(message.param1)
            version = message.command == REQUEST_VERSION or asked == _VERSION
            result = ACCEPTED if version or self._streams.once(asked) else UNSUPPORTED
        else:
            result = UNSUPPORTED
        sender = (message.get_srcSystem(), message.get_srcComponent())
        yield command_ack(message.command, result, *sender)
        if version:
            yield autopilot_version(_MAVLINK2, (1, 0, 0), self._who[0])


def _whole(value: float) -> int:
    """A parameter as a whole number; -1 where it is none."""
    return int(value) if math.isfinite(value) and value == int(value) else -1
