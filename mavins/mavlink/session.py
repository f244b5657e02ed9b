"""The MAVLink session, sans I/O: bytes, addresses and time go in, datagrams come out.

A datagram is scanned alone, so that a damaged one cannot spoil the next. Only IMU messages make a vehicle; a
vehicle belongs to the first address that speaks for it. Whoever sends a valid packet is a peer and gets every stream
until it has been silent for a while. Time is the reception stamp (integer microseconds since 1970, taken once per
datagram), so that a recording of the packets and their stamps gives the same estimates again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from mavins.estimator.estimator import Estimator
from mavins.mavlink.asking import SPOKEN, Asking
from mavins.mavlink.autopilot_output import AutopilotOutput
from mavins.mavlink.autopilot_settings import AutopilotOutputSettings, MonitorSettings
from mavins.mavlink.codec import (
    IMU_KINDS,
    Damage,
    Frames,
    OriginRequest,
    scan,
    statustext,
)
from mavins.mavlink.codec import decode as decode_frame
from mavins.mavlink.identity import identity_for
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.mavlink.microservice import Request
from mavins.mavlink.monitor import Monitor
from mavins.mavlink.outbox import Outbox, Recorder, Seal, Transmit
from mavins.mavlink.parameters import (
    PARAM_SET,
    ParameterStore,
    VehicleParameters,
    is_refused,
)
from mavins.mavlink.peers import Identity, Peers
from mavins.mavlink.requests import (
    BY_MSGID,
    MICROSERVICES,
    REQUESTS,
    SET_GPS_GLOBAL_ORIGIN,
    changes_state,
    decode_packet,
    is_for,
)
from mavins.mavlink.router import Router
from mavins.mavlink.settings import AskingSettings, SessionSettings, StreamSettings
from mavins.mavlink.signing import Verdict, unsigned, without_secrets
from mavins.mavlink.sources import ARDUPILOT, PX4, SourceSettings
from mavins.mavlink.vehicle import Holder, Vehicle
from mavins.types import Origin

_RELEVANT: Final = frozenset(RELEVANT.tolist())
_WARNING: Final = 4
_WARNING_ID: Final = 0xFFFF
"""MAV_SEVERITY of a refusal, and the number of its text, which no other text comes to."""


class SessionConfig(Protocol):
    """What a session is told about its work; `mavins.config.Config` is one."""

    @property
    def mavlink(self) -> SessionSettings:
        """Who we are, and for how long others count."""

    @property
    def streams(self) -> StreamSettings:
        """What is sent how often."""

    @property
    def sources(self) -> SourceSettings:
        """Which messages are used."""

    @property
    def asking(self) -> AskingSettings:
        """What an autopilot is asked for."""

    @property
    def monitor(self) -> MonitorSettings:
        """When an autopilot's own estimate is doubted."""

    @property
    def autopilot_output(self) -> AutopilotOutputSettings:
        """What an autopilot is given."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a session has around it; without any it works in memory, trusts everyone and keeps nothing.

    `is_local` tells who may change our state; `transmit` sends a packet as soon as it is made, without it they wait for
    `Session.datagrams`; `verify` and `seal` are for signing; `make_store` gives a vehicle its parameters.
    """

    is_local: Callable[[Hashable], bool] = lambda address: True
    recorder: Recorder | None = None
    transmit: Transmit | None = None
    verify: Callable[[Frames, Hashable], Verdict] | None = None
    seal: Seal | None = None
    make_store: Callable[[Vehicle], ParameterStore | None] = lambda vehicle: None


class Session:
    """All peers and vehicles of a service."""

    def __init__(
        self,
        config: SessionConfig,
        make_estimator: Callable[[int], Estimator],
        surroundings: Surroundings = Surroundings(),
    ) -> None:
        settings = config.mavlink
        self.vehicles: dict[int, Vehicle] = {}
        self.dropped: Counter[str] = Counter()
        self.peers = Peers(settings.max_peers, round(settings.peer_timeout * 1e6), self.dropped)
        self.packets_in = 0
        self.packets_routed = 0
        self._config = config
        self._settings = settings
        self._make_estimator = make_estimator
        self._around = surroundings
        self._outbox = Outbox(
            self.peers, surroundings.recorder, surroundings.transmit, surroundings.seal
        )
        self._router = Router() if settings.route else None
        self.asking = Asking(
            config.asking, settings.max_vehicles, round(settings.vehicle_timeout * 1e6)
        )
        self._seen_sysids: set[int] = set()
        self._wanted_origins: list[OriginRequest] = []

    def add_peer(self, address: Hashable) -> None:
        """A peer that receives without having sent."""
        self.peers.name(address)

    def hang_up(self, address: Hashable) -> None:
        """The connection with an address ended: no more goes there, and others may speak for its vehicles at once.

        A peer that was named by the user stays: the connection may come back.
        """
        if self.peers.drop(address):
            self._forget(address)
        for vehicle in self.vehicles.values():
            if vehicle.holder.address == address:
                vehicle.holder.address = None

    def receive(self, data: bytes, address: Hashable, now_us: int) -> Frames:
        """Take one datagram; returns its packets that were let in (evaluation looks for truth among them)."""
        frames = without_secrets(scan(data, now_us))
        if frames.damage:
            self._count_damage(frames.damage)
        if not len(frames):
            return frames
        self.packets_in += len(frames)
        signed = False
        if self._around.verify is not None:
            verdict = self._around.verify(frames, address)
            signed = bool(verdict.signed.all())
            if verdict.refused:
                self.dropped.update(verdict.refused)
                frames = frames.select(verdict.keep)
                if not len(frames):
                    return frames
        frames = self._let_in(frames, address, now_us)
        if self._router is not None:
            self._router.hear(frames, address)
            for packet, to in self._router.forward(frames, address, self.peers):
                self._outbox.transmit(packet, to)
                self.packets_routed += 1
        msgids, sysids = frames.msgid.tolist(), frames.sysid.tolist()
        if self.asking.lone or not self.asking.heard.isdisjoint(msgids):
            self.asking.take(frames, address, now_us, self.vehicles, self._identity)
        requests = {i: decode_packet(frames, i) for i, n in enumerate(msgids) if n in REQUESTS}
        trusted = self._settings.allow_remote_config or signed or self._around.is_local(address)
        # a recording holds only requests that were carried out, so that a replay may carry them out again
        refused = [i for i, m in requests.items() if m and not self._allows(m, trusted)]
        recorder = self._around.recorder
        if recorder is not None:
            for i in range(len(frames)):
                if i not in refused:
                    recorder.write(now_us, unsigned(frames.packet(i)))
        start = 0
        # a request takes effect at its place among the packets, as it will in a replay
        for i, message in requests.items():
            self._feed(frames, sysids, msgids, start, i)
            if message is not None:
                sender = (sysids[i], int(frames.compid[i]))
                request = Request(message, sender, address, trusted, now_us)
                self._answer(request, frames, i)
                if i in refused and not trusted:
                    self._warn(address)
            start = i + 1
        self._feed(frames, sysids, msgids, start, len(msgids))
        return frames

    def _feed(
        self, frames: Frames, sysids: list[int], msgids: list[int], start: int, end: int
    ) -> None:
        """Hand a stretch of packets to the vehicles that they are from."""
        for sysid in dict.fromkeys(sysids[start:end]):
            vehicle = self.vehicles.get(sysid)
            if vehicle is None:
                continue
            mine = [k for k in range(start, end) if sysids[k] == sysid and msgids[k] in _RELEVANT]
            if mine:
                chosen = frames if len(mine) == len(msgids) else frames.select(np.array(mine))
                now_us = int(frames.t_us[0])
                self._outbox.say(vehicle, vehicle.take(chosen), now_us)
                due = vehicle.estimate_due()
                if due is not None:
                    spared = self._autopilots()
                    self._outbox.stream(vehicle, vehicle.telemetry(), due, spared, now_us)
                for payload in vehicle.output_due():
                    self._outbox.answer(vehicle, payload, vehicle.holder.address, now_us)

    def tick(self, now_us: int) -> None:
        """What is due by our own clock; call it some ten times a second."""
        for vehicle in self.vehicles.values():
            outbox, due = self._outbox, vehicle.service_due(now_us)
            outbox.say(vehicle, vehicle.tick(now_us), now_us)
            outbox.stream(vehicle, vehicle.telemetry(), due, self._autopilots(), now_us)
            for service in MICROSERVICES:
                for address, payload in service.tick(now_us, vehicle):
                    outbox.answer(vehicle, payload, address, now_us)
        for said in self.asking.tick(now_us, self.vehicles, self._identity):
            speaker = said.autopilot
            if said.to_all:
                self._outbox.say(speaker, [said.payload], now_us)
            else:
                self._outbox.answer(speaker, said.payload, speaker.address, now_us)
        for address in self.peers.expire(now_us):
            self._forget(address)

    def _forget(self, address: Hashable) -> None:
        """A peer has gone."""
        for vehicle in self.vehicles.values():
            vehicle.forget_peer(address)
        if self._router is not None:
            self._router.forget(address)

    def datagrams(self) -> list[tuple[bytes, Hashable]]:
        """What is to be sent now: (bytes, address), in order."""
        out = self._outbox.waiting[:]
        self._outbox.waiting.clear()
        return out

    @property
    def packets_out(self) -> int:
        """How many packets of ours went to peers."""
        return self._outbox.count

    # ---- who may come in ---------------------------------------------------------------------------------------

    def _let_in(self, frames: Frames, address: Hashable, now_us: int) -> Frames:
        """The packets that count: not our own that came back, and of a vehicle only those of its own address."""
        sysids, compids, out = frames.sysid.tolist(), frames.compid.tolist(), set[int]()
        if self._is_usual(sysids, compids, address):
            self.vehicles[sysids[0]].holder.seen_us = now_us
            self._see_peer(address, now_us)
            return frames
        ours = {vehicle.identity for vehicle in self.vehicles.values()}
        taken = {who.sysid for who in ours if who.sysid not in self.vehicles}
        msgids = frames.msgid.tolist()
        echo = [
            i
            for i, who in enumerate(zip(sysids, compids, strict=True))
            if who in ours or self.asking.is_echo(who, msgids[i])
        ]
        if echo:
            out.update(echo)
            self.dropped["our own packets"] += len(echo)
        for sysid in sorted(set(sysids) - taken):
            at = [i for i, s in enumerate(sysids) if s == sysid and i not in out]
            vehicle = self.vehicles.get(sysid)
            if vehicle is not None and vehicle.holder.address not in (None, address):
                silent_us = now_us - vehicle.holder.seen_us
                if silent_us <= self._settings.vehicle_timeout * 1e6:
                    out.update(at)
                    self.dropped[f"sysid {sysid} from another address"] += len(at)
                    continue
            if any(msgids[i] not in SPOKEN for i in at):
                self._seen_sysids.add(sysid)
            if vehicle is None and any(msgids[i] in IMU_KINDS for i in at):
                vehicle = self._new_vehicle(sysid, address, now_us)
            if vehicle is not None:
                vehicle.holder = Holder(address, now_us)
        if out:
            frames = frames.select(np.array([i for i in range(len(sysids)) if i not in out], int))
        if len(frames):
            self._see_peer(address, now_us)
        return frames

    def _is_usual(self, sysids: list[int], compids: list[int], address: Hashable) -> bool:
        """True for packets of one vehicle from its own address: nothing more is to be looked at."""
        vehicle = self.vehicles.get(sysids[0])
        return (
            vehicle is not None
            and vehicle.holder.address == address
            and sysids.count(sysids[0]) == len(sysids)
            and all(
                v.identity.sysid != sysids[0] or v.identity.compid not in compids
                for v in self.vehicles.values()
            )
        )

    def _see_peer(self, address: Hashable, now_us: int) -> None:
        if not self.peers.see(address, now_us):
            return
        for vehicle in self.vehicles.values():
            for payload in vehicle.welcome():
                self._outbox.answer(vehicle, payload, address, now_us)

    def _new_vehicle(self, sysid: int, address: Hashable, now_us: int) -> Vehicle | None:
        if len(self.vehicles) >= self._settings.max_vehicles:
            self.dropped["more vehicles than max_vehicles"] += 1
            return None
        estimator = self._make_estimator(sysid)
        monitor = Monitor(self._config.monitor, estimator)
        intake = Intake(estimator, self._config.sources, monitor)
        vehicle = Vehicle(
            sysid,
            self._identity(sysid),
            estimator,
            intake,
            Holder(address, now_us),
            self._config.streams,
            round(self._settings.vehicle_timeout * 1e6),
            self._settings.persona,
            monitor=monitor,
            output=AutopilotOutput(self._config.autopilot_output, intake.clock),
        )
        vehicle.parameters = VehicleParameters(self._around.make_store(vehicle))
        self.vehicles[sysid] = vehicle
        for request in self._wanted_origins:
            if request.target_system in (0, vehicle.identity.sysid):
                vehicle.set_origin(Origin(request.lat, request.lon, request.alt))
        return vehicle

    def _identity(self, sysid: int) -> Identity:
        ours = {vehicle.identity.sysid for vehicle in self.vehicles.values()}
        return identity_for(sysid, self._settings, self._seen_sysids, ours)

    def _count_damage(self, damage: Damage) -> None:
        for name in ("bad_crc", "unknown", "truncated", "skipped_bytes"):
            count = getattr(damage, name)
            if count:
                self.dropped[name.replace("_", " ")] += count

    def _autopilots(self) -> set[Hashable]:
        """The addresses of vehicles that have a filter of their own."""
        return {
            v.holder.address
            for v in self.vehicles.values()
            if v.intake.autopilot in (ARDUPILOT, PX4)
        }

    # ---- what is asked of us -----------------------------------------------------------------------------------

    def _answer(self, request: Request, frames: Frames, i: int) -> None:
        """Send the replies to a request, if it is meant for one of ours."""
        msgid = request.message.get_msgId()
        if msgid == SET_GPS_GLOBAL_ORIGIN:
            if request.trusted:
                self._origin(frames, i, request.now_us)
            return
        for vehicle in self.vehicles.values():
            if not is_for(request.message, vehicle.identity):
                continue
            for reply in BY_MSGID[msgid].answer(request, vehicle):
                if reply.to_all:
                    self._outbox.say(vehicle, [reply.payload], request.now_us)
                else:
                    self._outbox.answer(vehicle, reply.payload, request.address, request.now_us)

    def _allows(self, message: Any, trusted: bool) -> bool:
        """False for a change that will be refused."""
        if not changes_state(message):
            return True
        if message.get_msgId() != PARAM_SET:
            return trusted
        asked = [v for v in self.vehicles.values() if is_for(message, v.identity)]
        return trusted and not all(is_refused(message, v.parameters.store) for v in asked)

    def _warn(self, address: Hashable) -> None:
        """Tell a peer once that it may not change our state."""
        self.dropped["changes asked for by another host"] += 1
        peer = self.peers.get(address)
        if peer is None or peer.warned:
            return
        peer.warned = True
        text = "mavins: changes are taken from its own host only (serve --allow-remote-config)"
        for vehicle in self.vehicles.values():
            for payload in statustext(text, _WARNING, _WARNING_ID):
                self._outbox.send(vehicle, payload, address)

    def _origin(self, frames: Frames, i: int, now_us: int) -> None:
        request = decode_frame(frames, i)
        if not isinstance(request, OriginRequest):
            self.dropped["SET_GPS_GLOBAL_ORIGIN unusable"] += 1
            return
        # a vehicle that is not here yet will be told
        self._wanted_origins = [
            r for r in self._wanted_origins if r.target_system != request.target_system
        ]
        self._wanted_origins.append(request)
        for vehicle in self.vehicles.values():
            if request.target_system in (0, vehicle.identity.sysid):
                origin = Origin(request.lat, request.lon, request.alt)
                self._outbox.say(vehicle, vehicle.set_origin(origin), now_us)
