"""Messages of others that ask something of us: which they are, whom they mean, and which would change our state."""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Frames, fields_of
from mavins.mavlink.commands import CHANGING, COMMAND_INT, COMMAND_LONG, Commands
from mavins.mavlink.ftp import FileTransfer
from mavins.mavlink.microservice import Microservice
from mavins.mavlink.parameter_service import Parameters
from mavins.mavlink.parameters import PARAM_SET
from mavins.mavlink.peers import Identity
from mavins.mavlink.small_talk import SmallTalk

SET_GPS_GLOBAL_ORIGIN: Final = fields_of("SET_GPS_GLOBAL_ORIGIN").msgid
MICROSERVICES: Final[tuple[Microservice, ...]] = (
    Commands(),
    Parameters(),
    FileTransfer(),
    SmallTalk(),
)
"""All protocols that we answer in, each a module and a line here."""
BY_MSGID: Final = {msgid: service for service in MICROSERVICES for msgid in service.msgids}
REQUESTS: Final = frozenset((*BY_MSGID, SET_GPS_GLOBAL_ORIGIN))
"""The messages that the session decodes through pymavlink."""


def decode_packet(frames: Frames, i: int) -> Any | None:
    """A packet through pymavlink, for the messages that our own codec leaves to it; None if it refuses."""
    try:
        return dialect.MAVLink(None).decode(bytearray(frames.packet(i)))
    except (dialect.MAVError, UnicodeDecodeError):
        return None


def changes_state(message: Any) -> bool:
    """True for what is taken from trusted peers only."""
    msgid = message.get_msgId()
    if msgid in (COMMAND_INT, COMMAND_LONG):
        return int(message.command) in CHANGING
    return msgid in (SET_GPS_GLOBAL_ORIGIN, PARAM_SET)


def is_for(message: Any, who: Identity) -> bool:
    """True for a message to us: by name, to all, or without a target.

    A companion shares its sysid with the autopilot, so it answers only what names it, or everybody everywhere.
    """
    system = int(getattr(message, "target_system", 0))
    component = int(getattr(message, "target_component", 0))
    return system in (0, who.sysid) and component in (0, who.compid)
