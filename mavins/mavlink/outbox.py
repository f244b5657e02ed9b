"""What goes out: each packet numbered for its peer, sealed where there is a key, and recorded once."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Hashable, Iterable
from typing import Final, Protocol

from mavins.mavlink.codec import Payload, fields_of, frame
from mavins.mavlink.peers import Peer, Peers, Speaker
from mavins.mavlink.streams import Telemetry
from mavins.mavlink.vehicle import Due

_NOT_TO_AUTOPILOTS: Final = frozenset(fields_of(n).msgid for n in ("ODOMETRY", "SYSTEM_TIME"))
"""An autopilot would take them for an external position, and set its clock by our time."""


class Recorder(Protocol):
    """Where every packet in and out goes, with its stamp (us since 1970)."""

    def write(self, t_us: int, packet: bytes) -> None:
        """Append one packet."""


Transmit = Callable[[bytes, Hashable], None]
Seal = Callable[[bytes, Hashable], bytes]
"""Signs a packet to an address, or leaves it as it is."""


class Outbox:
    """Sends payloads to `peers`. Without a way to transmit, datagrams wait in `waiting`."""

    def __init__(
        self,
        peers: Peers,
        recorder: Recorder | None = None,
        transmit: Transmit | None = None,
        seal: Seal | None = None,
    ) -> None:
        self.count = 0
        self.waiting: list[tuple[bytes, Hashable]] = []
        self.transmit = transmit or (lambda data, address: self.waiting.append((data, address)))
        self._peers = peers
        self._recorder = recorder
        self._recorded = Peer(None)
        self._seal = seal

    def say(self, speaker: Speaker, payloads: Iterable[Payload], now_us: int) -> None:
        """Send news to every peer."""
        for payload in payloads:
            for address in self._peers:
                self.send(speaker, payload, address)
            self.record(speaker, payload, now_us)

    def answer(self, speaker: Speaker, payload: Payload, address: Hashable, now_us: int) -> None:
        """Send to one peer."""
        self.send(speaker, payload, address)
        self.record(speaker, payload, now_us)

    def stream(
        self,
        speaker: Speaker,
        telemetry: Telemetry,
        due: Due,
        spared: Collection[Hashable],
        now_us: int,
    ) -> None:
        """Send what is due: the usual to most peers, and to some what they asked for.

        `spared` are the addresses of autopilots, which are not sent everything.
        """
        usual = [address for address in self._peers if address not in due.own]
        for name in dict.fromkeys((*due.usual, *itertools.chain.from_iterable(due.own.values()))):
            payload = telemetry[name]
            if payload is None:
                continue
            wanting = [address for address, names in due.own.items() if name in names]
            for address in (*(usual if name in due.usual else ()), *wanting):
                if payload.msgid not in _NOT_TO_AUTOPILOTS or address not in spared:
                    self.send(speaker, payload, address)
            self.record(speaker, payload, now_us)

    def record(self, speaker: Speaker, payload: Payload, now_us: int) -> None:
        """Record what was sent, once for all peers."""
        if self._recorder is not None:
            who = speaker.identity
            self._recorder.write(now_us, frame(payload, *who, self._recorded.next_sequence(who)))

    def send(self, speaker: Speaker, payload: Payload, address: Hashable) -> None:
        """Send to one peer, without recording."""
        peer = self._peers.get(address)
        if peer is None:
            return
        who = speaker.identity
        packet = frame(payload, *who, peer.next_sequence(who))
        self.transmit(packet if self._seal is None else self._seal(packet, address), address)
        self.count += 1
