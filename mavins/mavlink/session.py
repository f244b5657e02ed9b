"""The MAVLink session, sans I/O: bytes, addresses and time go in, datagrams come out.

A datagram is scanned alone, so that a damaged one cannot spoil the next. Only IMU messages make a vehicle; a
vehicle belongs to the first address that speaks for it. Whoever sends a valid packet is a peer and gets every stream
until it has been silent for a while. Time is the reception stamp (integer microseconds since 1970, taken once per
datagram), so that a recording of the packets and their stamps gives the same estimates again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from mavins.estimator.estimator import Estimator
from mavins.mavlink.codec import IMU_KINDS, Damage, Frames, OriginRequest, Payload, frame, scan
from mavins.mavlink.codec import decode as decode_frame
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.mavlink.requests import COMMANDS, SET_GPS_GLOBAL_ORIGIN, answer, decode_packet
from mavins.mavlink.settings import SessionSettings, StreamSettings
from mavins.mavlink.sources import ARDUPILOT, PX4, SourceSettings
from mavins.mavlink.vehicle import Holder, Vehicle
from mavins.types import Origin

COMPID: Final = 1
_RELEVANT: Final = frozenset(RELEVANT.tolist())
_REQUESTS: Final = frozenset((*COMMANDS, SET_GPS_GLOBAL_ORIGIN))
_ODOMETRY = 331


class Recorder(Protocol):
    """Where every packet in and out goes, with its stamp (us since 1970)."""

    def write(self, t_us: int, packet: bytes) -> None:
        """Append one packet."""


@dataclass(slots=True)
class Peer:
    """An address that receives our streams. `seen_us` None: one that was named by the user and never expires."""

    seen_us: int | None
    sequence: dict[int, int] = field(default_factory=dict)

    def next_sequence(self, sysid: int) -> int:
        """The number of the next packet of one of our sysids to this peer."""
        number = self.sequence.get(sysid, 0)
        self.sequence[sysid] = (number + 1) % 256
        return number


def sysid_for(
    sysid: int, settings: SessionSettings, seen: Collection[int], ours: Collection[int]
) -> int:
    """The sysid under which we speak about vehicle `sysid`: of those not `seen` in use, nor `ours` for another one."""
    if settings.sysid != "auto" and not ours:
        return settings.sysid
    candidates = [1 + (sysid + 98 + k) % 250 for k in range(250)]
    free = [c for c in candidates if c not in ours]
    return next((c for c in free if c not in seen), free[0])


class Session:
    """All peers and vehicles of a service."""

    def __init__(
        self,
        settings: SessionSettings,
        streams: StreamSettings,
        sources: SourceSettings,
        make_estimator: Callable[[int], Estimator],
        is_local: Callable[[Hashable], bool] = lambda address: True,
        recorder: Recorder | None = None,
        transmit: Callable[[bytes, Hashable], None] | None = None,
    ) -> None:
        self.vehicles: dict[int, Vehicle] = {}
        self.peers: dict[Hashable, Peer] = {}
        self.dropped: Counter[str] = Counter()
        self.packets_in = 0
        self.packets_out = 0
        self._settings = settings
        self._streams = streams
        self._sources = sources
        self._make_estimator = make_estimator
        self._is_local = is_local
        self._recorder = recorder
        self._recorded = Peer(None)
        self._out: list[tuple[bytes, Hashable]] = []
        # a service sends each packet as soon as it is made; without one they wait for `datagrams`
        self._transmit = transmit or (lambda data, address: self._out.append((data, address)))
        self._seen_sysids: set[int] = set()
        self._wanted_origins: list[OriginRequest] = []

    def add_peer(self, address: Hashable) -> None:
        """A peer that receives without having sent."""
        self.peers[address] = Peer(None)

    def hang_up(self, address: Hashable) -> None:
        """The connection with an address ended: no more goes there, and others may speak for its vehicles at once.

        A peer that was named by the user stays: the connection may come back.
        """
        peer = self.peers.get(address)
        if peer is not None and peer.seen_us is not None:
            del self.peers[address]
        for vehicle in self.vehicles.values():
            if vehicle.holder.address == address:
                vehicle.holder.address = None

    def receive(self, data: bytes, address: Hashable, now_us: int) -> Frames:
        """Take one datagram; returns its packets that were let in (evaluation looks for truth among them)."""
        frames = scan(data, now_us)
        if frames.damage:
            self._count_damage(frames.damage)
        if not len(frames):
            return frames
        self.packets_in += len(frames)
        frames = self._let_in(frames, address, now_us)
        if self._recorder is not None:
            for i in range(len(frames)):
                self._recorder.write(now_us, frames.packet(i))
        msgids, sysids = frames.msgid.tolist(), frames.sysid.tolist()
        start = 0
        # a request takes effect at its place among the packets, as it will in a replay
        for i in [i for i, msgid in enumerate(msgids) if msgid in _REQUESTS]:
            self._feed(frames, sysids, msgids, start, i)
            self._request(frames, i, address, now_us)
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
                self._say(vehicle, vehicle.take(chosen), int(frames.t_us[0]))

    def tick(self, now_us: int) -> None:
        """What is due by our own clock; call it some ten times a second."""
        for vehicle in self.vehicles.values():
            self._say(vehicle, vehicle.tick(now_us), now_us)
        limit_us = self._settings.peer_timeout * 1e6
        for address, peer in list(self.peers.items()):
            if peer.seen_us is not None and now_us - peer.seen_us > limit_us:
                del self.peers[address]

    def datagrams(self) -> list[tuple[bytes, Hashable]]:
        """What is to be sent now: (bytes, address), in order."""
        out, self._out = self._out, []
        return out

    # ---- who may come in ---------------------------------------------------------------------------------------

    def _let_in(self, frames: Frames, address: Hashable, now_us: int) -> Frames:
        """The packets that count: not our own that came back, and of a vehicle only those of its own address."""
        sysids, out = frames.sysid.tolist(), set[int]()
        if self._is_usual(sysids, address):
            self.vehicles[sysids[0]].holder.seen_us = now_us
            self._see_peer(address, now_us)
            return frames
        ours = {vehicle.our_sysid for vehicle in self.vehicles.values()}
        if not self._is_local(address):
            # turned away here and not later, so that a recording holds only requests that were carried out
            foreign = np.flatnonzero(frames.msgid == SET_GPS_GLOBAL_ORIGIN).tolist()
            out.update(foreign)
            self.dropped["SET_GPS_GLOBAL_ORIGIN from another host"] += len(foreign)
        for sysid in sorted(set(sysids)):
            at = [i for i, s in enumerate(sysids) if s == sysid]
            if sysid in ours:
                echo = [i for i in at if int(frames.compid[i]) == COMPID]
                out.update(echo)
                self.dropped["our own packets"] += len(echo)
                continue
            vehicle = self.vehicles.get(sysid)
            if vehicle is not None and vehicle.holder.address not in (None, address):
                silent_us = now_us - vehicle.holder.seen_us
                if silent_us <= self._settings.vehicle_timeout * 1e6:
                    out.update(at)
                    self.dropped[f"sysid {sysid} from another address"] += len(at)
                    continue
            self._seen_sysids.add(sysid)
            if vehicle is None and any(int(frames.msgid[i]) in IMU_KINDS for i in at):
                vehicle = self._new_vehicle(sysid, address, now_us)
            if vehicle is not None:
                vehicle.holder = Holder(address, now_us)
        if out:
            frames = frames.select(np.array([i for i in range(len(sysids)) if i not in out], int))
        if len(frames):
            self._see_peer(address, now_us)
        return frames

    def _is_usual(self, sysids: list[int], address: Hashable) -> bool:
        """True for packets of one vehicle from its own address on this host: nothing more is to be looked at."""
        vehicle = self.vehicles.get(sysids[0])
        return (
            vehicle is not None
            and vehicle.holder.address == address
            and sysids.count(sysids[0]) == len(sysids)
            and self._is_local(address)
            and all(v.our_sysid != sysids[0] for v in self.vehicles.values())
        )

    def _see_peer(self, address: Hashable, now_us: int) -> None:
        peer = self.peers.get(address)
        if peer is not None:
            if peer.seen_us is not None:
                peer.seen_us = now_us
        elif len(self.peers) < self._settings.max_peers:
            self.peers[address] = Peer(now_us)
            for vehicle in self.vehicles.values():
                for payload in vehicle.welcome():
                    self._send(vehicle, payload, address)
                    self._record(vehicle, payload, now_us)
        else:
            self.dropped["more peers than max_peers"] += 1

    def _new_vehicle(self, sysid: int, address: Hashable, now_us: int) -> Vehicle | None:
        if len(self.vehicles) >= self._settings.max_vehicles:
            self.dropped["more vehicles than max_vehicles"] += 1
            return None
        estimator = self._make_estimator(sysid)
        vehicle = Vehicle(
            sysid,
            self._our_sysid(sysid),
            estimator,
            Intake(estimator, self._sources),
            Holder(address, now_us),
            self._streams,
            round(self._settings.vehicle_timeout * 1e6),
        )
        self.vehicles[sysid] = vehicle
        for request in self._wanted_origins:
            if request.target_system in (0, vehicle.our_sysid):
                vehicle.set_origin(Origin(request.lat, request.lon, request.alt))
        return vehicle

    def _our_sysid(self, sysid: int) -> int:
        ours = {vehicle.our_sysid for vehicle in self.vehicles.values()}
        return sysid_for(sysid, self._settings, self._seen_sysids, ours)

    def _count_damage(self, damage: Damage) -> None:
        for name in ("bad_crc", "unknown", "truncated", "skipped_bytes"):
            count = getattr(damage, name)
            if count:
                self.dropped[name.replace("_", " ")] += count

    # ---- what goes out -----------------------------------------------------------------------------------------

    def _say(self, vehicle: Vehicle, payloads: Iterable[Payload], now_us: int) -> None:
        """Send payloads about a vehicle to every peer; an autopilot is spared our ODOMETRY.

        An autopilot would take it for an external position, or complain about each one.
        """
        autopilots = {
            v.holder.address
            for v in self.vehicles.values()
            if v.intake.autopilot in (ARDUPILOT, PX4)
        }
        for payload in payloads:
            for address in self.peers:
                if payload.msgid != _ODOMETRY or address not in autopilots:
                    self._send(vehicle, payload, address)
            self._record(vehicle, payload, now_us)

    def _record(self, vehicle: Vehicle, payload: Payload, now_us: int) -> None:
        if self._recorder is not None:
            number = self._recorded.next_sequence(vehicle.our_sysid)
            self._recorder.write(now_us, frame(payload, vehicle.our_sysid, COMPID, number))

    def _send(self, vehicle: Vehicle, payload: Payload, address: Hashable) -> None:
        peer = self.peers.get(address)
        if peer is None:
            return
        number = peer.next_sequence(vehicle.our_sysid)
        self._transmit(frame(payload, vehicle.our_sysid, COMPID, number), address)
        self.packets_out += 1

    def _request(self, frames: Frames, i: int, address: Hashable, now_us: int) -> None:
        """Answer a command, or take an origin, if it is meant for one of ours."""
        msgid = int(frames.msgid[i])
        sender = (int(frames.sysid[i]), int(frames.compid[i]))
        if msgid == SET_GPS_GLOBAL_ORIGIN:
            self._origin(frames, i, now_us)
            return
        message = decode_packet(frames, i)
        if message is None or message.target_component not in (0, COMPID):
            return
        for vehicle in self.vehicles.values():
            if message.target_system in (0, vehicle.our_sysid):
                for payload in answer(message, sender, vehicle):
                    self._send(vehicle, payload, address)
                    self._record(vehicle, payload, now_us)

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
            if request.target_system in (0, vehicle.our_sysid):
                origin = Origin(request.lat, request.lon, request.alt)
                self._say(vehicle, vehicle.set_origin(origin), now_us)
