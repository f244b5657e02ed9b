"""Asking autopilots for what we need: messages by SET_MESSAGE_INTERVAL (511), and their time by TIMESYNC.

An autopilot is who sends HEARTBEAT from component 1, before there is a vehicle too: ArduPilot sends no IMU until it is
asked. What comes at four fifths of its wished rate is never asked for. Otherwise one command at a time is sent,
because COMMAND_ACK does not say which message it is about; it is repeated while no answer comes, and a denied rate is
tried slower. What does not come then is told to people, with what to do about it.

All of this changes only what we send: it takes no part in the estimate.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from mavins.mavlink.codec import (
    Fields,
    Frames,
    Heartbeat,
    Payload,
    decode,
    fields_of,
    name_of,
    statustext,
)
from mavins.mavlink.peers import Identity
from mavins.mavlink.settings import AskingSettings
from mavins.mavlink.timesync import TIMESYNC, Timesync
from mavins.mavlink.vehicle import Vehicle
from mavins.mavlink.wishes import COMMAND_LONG, SET_INTERVAL, State, Wish, fix_for, wishes_of

HEARTBEAT: Final = fields_of("HEARTBEAT").msgid
COMMAND_ACK: Final = fields_of("COMMAND_ACK")
HEARD: Final = frozenset((HEARTBEAT, COMMAND_ACK.msgid, TIMESYNC.msgid))
"""The messages that asking looks at."""
SPOKEN: Final = (COMMAND_LONG.msgid, TIMESYNC.msgid, fields_of("STATUSTEXT").msgid)
"""The messages that we send before there is a vehicle."""
ACK_US: Final = 1_000_000
TRIES: Final = 4
SILENT_US: Final = 30_000_000
"""An autopilot that answers nothing is asked again after this long."""
_AUTOPILOT_COMPID: Final = 1
_GCS: Final = 6
_GENERIC: Final = (0, 0)
_INVALID: Final = 8
_ACCEPTED, _TEMPORARILY_REJECTED, _DENIED, _FAILED, _IN_PROGRESS = 0, 1, 2, 4, 5
_WARNING: Final = 4
_NOTICE: Final = 5
_INFO: Final = 6
_FIRST_TEXT_ID: Final = 0x8000
"""Texts of a vehicle count from 1."""


class Said(NamedTuple):
    """A payload of ours for an autopilot, or for all peers."""

    autopilot: Autopilot
    payload: Payload
    to_all: bool = False


@dataclass(slots=True)
class Autopilot:
    """One autopilot: who it is, under which ids we speak to it, and what we wish of it.

    `counts` are the messages that came from it, by name: the vehicle's own once there is one.
    """

    sysid: int
    kind: int
    address: Hashable
    seen_us: int
    identity: Identity
    wishes: list[Wish]
    timesync: Timesync = field(default_factory=Timesync)
    counts: Counter[str] = field(default_factory=Counter)
    remark: str = ""
    _waiting: Wish | None = None
    _tries: int = 0
    _sent_us: int = 0
    _free_us: int = 0
    _reboots: int = 0
    _text_id: int = 0
    _texts: list[Payload] = field(default_factory=list)

    @property
    def remarks(self) -> list[str]:
        """What is wrong with what it sends."""
        return [r for r in (self.remark, *(wish.remark for wish in self.wishes)) if r]

    def restart(self) -> None:
        """Ask from the beginning, as after a reboot."""
        self._waiting, self._free_us, self.remark = None, 0, ""
        for wish in self.wishes:
            wish.restart()

    def join(self, vehicle: Vehicle) -> int | None:
        """Count as the vehicle does, and speak as we do about it; returns the time on its clock."""
        intake = vehicle.intake
        self.identity, self.address = vehicle.identity, vehicle.holder.address
        if self.counts is not intake.counts:
            self.counts, self._reboots = intake.counts, intake.reboots
        if self._reboots != intake.reboots:
            self._reboots = intake.reboots
            self.restart()
        for wish in self.wishes:
            if wish.is_imu and intake.imu.chosen is not None:
                wish.rename(intake.imu.name)
            elif wish.is_gnss and intake.sources is not None:
                wish.rename(intake.sources.receiver)
        return intake.clock.newest_us

    def tick(self, now_us: int, vehicle_us: int | None) -> Iterator[Said]:
        """Measure, give up waiting, ask for the next; what is sent thereby."""
        for wish in self.wishes:
            if wish.measure(now_us, vehicle_us, self.counts[wish.name]):
                self._judge(wish, now_us)
        if self._waiting is not None and now_us - self._sent_us >= ACK_US:
            self._no_answer(self._waiting, now_us)
        if self._waiting is None and now_us >= self._free_us:
            self._waiting = next((w for w in self.wishes if w.state is State.WANTED), None)
            self._tries = 0
        if self._waiting is not None and (self._tries == 0 or now_us - self._sent_us >= ACK_US):
            yield Said(self, self._waiting.request(self.sysid, self._tries))
            self._tries += 1
            self._sent_us = now_us
        request = self.timesync.request(now_us)
        if request is not None:
            yield Said(self, request)
        texts, self._texts = self._texts, []
        for text in texts:
            yield Said(self, text, to_all=True)

    def acknowledge(self, result: int, now_us: int) -> None:
        """The answer to what was asked last."""
        wish = self._waiting
        if wish is None or result == _IN_PROGRESS:
            return
        self.remark = ""
        if result == _TEMPORARILY_REJECTED and self._tries < TRIES:
            return  # asked again when the time for an answer is over
        retried, self._waiting = self._tries > 1, None
        # the answer to another try may still be on its way: it must not pass for one to the next wish
        self._free_us = now_us + (ACK_US if retried else 0)
        if result == _ACCEPTED:
            wish.grant(now_us)
            if wish.step:
                what = f"gives {wish.name} at {wish.rate:g} Hz, not at {wish.rates[0]:g} Hz"
                self._note(wish, what, denied=True, severity=_NOTICE)
        elif result in (_DENIED, _FAILED) and wish.slower():
            return
        else:
            wish.state = State.GIVEN_UP
            how = "denies" if result in (_DENIED, _FAILED) else "cannot be asked for"
            what = f"{how} {wish.name}: {_came(wish)}"
            self._note(wish, what, denied=True)

    def _judge(self, wish: Wish, now_us: int) -> None:
        news = wish.judge(now_us)
        if wish.state is State.COMING and self._waiting is wish:
            self._waiting = None  # it comes: the answer was lost
        if news == "short":
            what = f"has accepted {wish.name} at {wish.rate:g} Hz, but {_came(wish)}"
            self._note(wish, what, denied=False)
        elif news == "comes":
            self._say(f"autopilot {self.sysid}: {wish.name} comes now", _INFO)

    def _no_answer(self, wish: Wish, now_us: int) -> None:
        if self._tries < TRIES:
            return
        self._waiting, self._free_us = None, now_us + SILENT_US
        if not self.remark:
            self.remark = (
                f"autopilot {self.sysid} does not answer SET_MESSAGE_INTERVAL ({wish.name}: "
                f"{_came(wish)}); {fix_for(self.kind, wish)}"
            )
            self._say(self.remark, _WARNING)

    def _note(self, wish: Wish, what: str, denied: bool, severity: int = _WARNING) -> None:
        fix = fix_for(self.kind, wish, denied)
        wish.remark = f"autopilot {self.sysid} {what}; {fix}"
        self._say(wish.remark, severity)

    def _say(self, text: str, severity: int) -> None:
        self._text_id = (self._text_id + 1) % _FIRST_TEXT_ID
        self._texts += statustext(f"mavins: {text}", severity, _FIRST_TEXT_ID + self._text_id)

    def summary(self) -> dict[str, Any]:
        """What was asked for and what came of it."""
        return {
            "remarks": self.remarks,
            "clock_offset_s": self.timesync.offset,
            "round_trip_s": self.timesync.round_trip,
            "messages": {
                wish.name: {
                    "wanted_hz": wish.rates[0],
                    "measured_hz": wish.measured,
                    "state": wish.state.name.lower().replace("_", " "),
                }
                for wish in self.wishes
            },
        }


class Asking:
    """All autopilots, at most `limit`; `timeout_us` of silence frees one for another address.

    `heard` are the messages that `take` is wanted for, `lone` says that it is for all: an autopilot is no vehicle yet.
    """

    def __init__(self, settings: AskingSettings, limit: int, timeout_us: int) -> None:
        self.autopilots: dict[int, Autopilot] = {}
        self.heard = HEARD if settings.enabled else frozenset[int]()
        self.lone = False
        self._settings = settings
        self._limit = limit
        self._timeout_us = timeout_us

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is wrong with what autopilots send, for people."""
        return tuple(r for autopilot in self.autopilots.values() for r in autopilot.remarks)

    def is_echo(self, who: tuple[int, int], msgid: int) -> bool:
        """True for what we said ourselves before there was a vehicle."""
        return msgid in SPOKEN and any(a.identity == who for a in self.autopilots.values())

    def take(
        self,
        frames: Frames,
        address: Hashable,
        now_us: int,
        vehicles: Mapping[int, Vehicle],
        identity_of: Callable[[int], Identity],
    ) -> None:
        """Look at the packets of one datagram."""
        senders = zip(frames.msgid.tolist(), frames.sysid.tolist(), strict=True)
        compids = frames.compid.tolist()
        for i, (msgid, sysid) in enumerate(senders):
            autopilot = self.autopilots.get(sysid)
            if compids[i] == _AUTOPILOT_COMPID and msgid == HEARTBEAT:
                autopilot = self._heartbeat(frames, i, address, now_us, identity_of)
            if autopilot is None or autopilot.address != address:
                continue
            if sysid not in vehicles:
                autopilot.counts[name_of(msgid)] += 1
            if compids[i] != _AUTOPILOT_COMPID:
                continue
            if msgid == COMMAND_ACK.msgid:
                ack = _values(COMMAND_ACK, frames, i)
                target = (ack["target_system"], ack["target_component"])
                ours = target in ((0, 0), autopilot.identity)
                if ours and ack["command"] == SET_INTERVAL:
                    autopilot.acknowledge(ack["result"], now_us)
            elif msgid == TIMESYNC.msgid:
                answer = _values(TIMESYNC, frames, i)
                if autopilot.timesync.take(answer["tc1"], answer["ts1"], now_us):
                    autopilot.restart()

    def tick(
        self,
        now_us: int,
        vehicles: Mapping[int, Vehicle],
        identity_of: Callable[[int], Identity],
    ) -> list[Said]:
        """What is due by our clock: what is to be sent, some twenty times a second."""
        said: list[Said] = []
        for sysid, autopilot in list(self.autopilots.items()):
            if now_us - autopilot.seen_us > self._timeout_us:
                autopilot.restart()
                if sysid not in vehicles:
                    del self.autopilots[sysid]
                continue
            vehicle, vehicle_us = vehicles.get(sysid), None
            if vehicle is None:
                autopilot.identity = identity_of(sysid)
            else:
                vehicle_us = autopilot.join(vehicle)
            said += autopilot.tick(now_us, vehicle_us)
        self.lone = any(sysid not in vehicles for sysid in self.autopilots)
        return said

    def _heartbeat(
        self,
        frames: Frames,
        i: int,
        address: Hashable,
        now_us: int,
        identity_of: Callable[[int], Identity],
    ) -> Autopilot | None:
        """The autopilot that a HEARTBEAT is from, or None where it is none of an autopilot."""
        message, sysid = decode(frames, i), int(frames.sysid[i])
        autopilot = self.autopilots.get(sysid)
        if not isinstance(message, Heartbeat) or not _is_autopilot(message):
            return autopilot
        if autopilot is None:
            if len(self.autopilots) >= self._limit:
                return None
            autopilot = self.autopilots[sysid] = Autopilot(
                sysid,
                message.autopilot,
                address,
                now_us,
                identity_of(sysid),
                wishes_of(self._settings),
            )
            self.lone = True
        elif autopilot.address == address or now_us - autopilot.seen_us > self._timeout_us:
            autopilot.address, autopilot.seen_us = address, now_us
            autopilot.kind = message.autopilot
        return autopilot


def _came(wish: Wish) -> str:
    return f"{wish.measured:.0f} of {wish.rates[0]:g} Hz come" if wish.measured else "none comes"


def _is_autopilot(message: Heartbeat) -> bool:
    """False for ground stations, cameras and the like, and for other services of our kind, which are generic twice."""
    kind = (message.type, message.autopilot)
    return message.autopilot != _INVALID and message.type != _GCS and kind != _GENERIC


def _values(fields: Fields, frames: Frames, i: int) -> dict[str, Any]:
    """The fields of packet i in wire units."""
    body = frames.body(i, fields.unpacker.size)
    return dict(zip(fields.names, fields.unpacker.unpack(body), strict=True))
