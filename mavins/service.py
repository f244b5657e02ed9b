"""The service: sockets in front of a session, result files and a status behind it."""

from __future__ import annotations

import contextlib
import functools
import os
import selectors
import time
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mavins import __version__
from mavins.config import Config, to_yaml
from mavins.estimator.estimator import Estimator, Outputs
from mavins.evaluation.live import HIL_STATE, LiveTruth
from mavins.logs.recording import Recording
from mavins.mavlink.codec import Frames
from mavins.mavlink.limits import Gate, may_change
from mavins.mavlink.session import Session, Surroundings
from mavins.mavlink.signing import Unsigned, Verdict, takes_unsigned
from mavins.mavlink.stream_buffer import StreamBuffer
from mavins.mavlink.vehicle import Vehicle
from mavins.outcome import summarize
from mavins.parameters import ConfigStore, file_keeper
from mavins.results import ResultWriter, check_folder, write_json, write_text
from mavins.runs import grid_us
from mavins.signing_store import Signing
from mavins.snapshot import aiding_status, estimate_status
from mavins.status import StatusSnapshot, VehicleStatus
from mavins.status_socket import StatusSocket
from mavins.tlog_source import tune
from mavins.transports.base import Link
from mavins.warmup import not_ready

TICK_S: Final = 0.05
STATUS_S: Final = 1.0
ROWS_PER_SECOND: Final = 50.0

Address = tuple[int, str, int]
"""Which of our links, and the host and port at its other end."""


def check_outputs(config: Config, out: Path | None, record: Path | None) -> None:
    """OutputError where results or a recording could not be written, long before there are any."""
    if out is not None:
        check_folder(out / config.filter)
    if record is not None:
        check_folder(record.parent)


@dataclass(slots=True)
class Watch:
    """What the service keeps about a vehicle beside its estimator."""

    truth: LiveTruth
    writer: ResultWriter | None
    folder: Path | None
    counts_before: Counter[str]
    counted_at: float


class Service:
    """Moves datagrams between links and a session until told to stop.

    `unsigned` says for each link whose packets are taken without a signature; None: as configured.
    """

    def __init__(
        self,
        config: Config,
        links: Sequence[Link],
        gcs: Sequence[Address] = (),
        out: Path | None = None,
        recording: Recording | None = None,
        status: Callable[[StatusSnapshot], None] | None = None,
        signing: Signing | None = None,
        config_path: Path | None = None,
        status_socket: StatusSocket | None = None,
        unsigned: Sequence[Unsigned | None] = (),
    ) -> None:
        self._config = config
        self._config_path = config_path
        self._links = links
        self._trusted = {index for index, link in enumerate(links) if link.trusted}
        self._buffers: dict[Address, StreamBuffer] = {}
        self._out = out
        self._status = status
        self._status_socket = status_socket
        self._watches: dict[int, Watch] = {}
        self._recorder = recording
        self._signing = signing
        policy = config.signing.unsigned
        self._unsigned = [given or policy for given in unsigned] or [policy] * len(links)
        self._signers = [] if signing is None else [signing.signer(k) for k in range(len(links))]
        self._unix_offset_us = time.time_ns() // 1000 - time.monotonic_ns() // 1000
        self._started = time.monotonic()
        self._cpu_started = time.process_time()
        self._gate = Gate(config.limits, self._now_us())
        self.session = Session(
            config,
            self._make_estimator,
            Surroundings(
                self._may_change,
                recording,
                self._transmit,
                None if signing is None else self._verify,
                None if signing is None else self._seal,
                self._make_store,
            ),
        )
        for address in gcs:
            self.session.add_peer(address)
        for index, link in enumerate(links):
            for host, port in link.peers:
                self.session.add_peer((index, host, port))

    def run(self, stopped: Callable[[], bool]) -> None:
        """Serve until `stopped()`; then close every file whole."""
        next_tick = next_status = time.monotonic()
        selector = selectors.DefaultSelector()
        try:
            for index, link in enumerate(self._links):
                drain = functools.partial(self._drain, index)
                selector.register(link.fileno(), selectors.EVENT_READ, drain)
            if self._status_socket is not None:
                answer = self._status_socket.answer
                selector.register(self._status_socket, selectors.EVENT_READ, answer)
            while not stopped():
                for key, _ in selector.select(max(0.0, next_tick - time.monotonic())):
                    key.data()
                now = time.monotonic()
                if now >= next_tick:
                    next_tick = now + TICK_S
                    self._tick()
                    self._write_rows()
                if now >= next_status:
                    next_status = now + STATUS_S
                    self._flush()
                    self._show(now)
        finally:
            selector.close()
            self.close()

    def _show(self, now: float) -> None:
        """Show a snapshot to all that want one."""
        if self._status is None and self._status_socket is None:
            return
        snapshot = self.snapshot(now)
        if self._status_socket is not None:
            self._status_socket.show(snapshot)
        if self._status is not None:
            self._status(snapshot)

    def _tick(self) -> None:
        """What is due by the clock."""
        for link in self._links:
            link.tick()
        now_us = self._now_us()
        for address, buffer in self._buffers.items():
            if packets := buffer.overdue(now_us):
                self._take(packets, address, now_us)
        self.session.tick(now_us)
        vehicles = [vehicle.holder.address for vehicle in self.session.vehicles.values()]
        self._gate.know(vehicles, self.session.peers, now_us)
        for index, link in enumerate(self._links):
            link.prefer([a[1:] for a in vehicles if isinstance(a, tuple) and a[0] == index])

    def _now_us(self) -> int:
        """Microseconds since 1970 that never step back."""
        return self._unix_offset_us + time.monotonic_ns() // 1000

    def _drain(self, index: int) -> None:
        """Take all that waits at a link, answering after each datagram."""
        link = self._links[index]
        for data, (host, port) in link.recv(0.0):
            address, now_us = (index, host, port), self._now_us()
            if not link.is_stream:
                if self._gate.admits(data, address, host, now_us):
                    self._take(data, address, now_us)
            elif not data:
                self._hang_up(address, now_us)
            elif self._gate.admits_piece(data, address, now_us):
                buffer = self._buffers.setdefault(address, StreamBuffer())
                if packets := buffer.push(data, now_us):
                    self._take(packets, address, now_us)

    def _hang_up(self, address: Address, now_us: int) -> None:
        """A stream ended: what it left is all that there will be."""
        buffer = self._buffers.pop(address, None)
        if buffer is not None and (rest := buffer.rest()):
            self._take(rest, address, now_us)
        self.session.hang_up(address)

    def _take(self, data: bytes, address: Address, now_us: int) -> None:
        """Hand packets to the session, and the truth among them to those who judge."""
        frames = self.session.receive(data, address, now_us)
        if HIL_STATE not in frames.msgid:
            return
        for sysid, vehicle in self.session.vehicles.items():
            self._watches[sysid].truth.take(frames, sysid, vehicle.estimator.solution())

    def _may_change(self, address: Hashable) -> bool:
        """True for who may change the state: programs of this host, and lines that the user trusts."""
        if not isinstance(address, tuple):
            return False
        return address[0] in self._trusted or may_change(str(address[1]), allow_remote=False)

    def _verify(self, frames: Frames, address: Hashable) -> Verdict:
        """Which packets may come in, by their signatures."""
        assert self._signing is not None
        assert isinstance(address, tuple)
        takes = takes_unsigned(self._unsigned[address[0]], self._may_change(address))
        return self._signing.verifier.check(frames, takes)

    def _seal(self, packet: bytes, address: Hashable) -> bytes:
        """A packet of ours with its signature."""
        assert isinstance(address, tuple)
        return self._signers[address[0]].sign(packet)

    def _dropped(self) -> dict[str, int]:
        """What was not used and not sent, by reason."""
        dropped = Counter(self.session.dropped)
        dropped.update(self._gate.dropped)
        for link in self._links:
            dropped.update(link.dropped)
        if self._recorder is not None:
            dropped["not recorded"] += self._recorder.lost
        if self._signing is not None:
            dropped["signing timestamps not saved"] += self._signing.save_errors
        return {reason: n for reason, n in dropped.items() if n}

    def _transmit(self, data: bytes, address: Hashable) -> None:
        assert isinstance(address, tuple)
        index, host, port = address
        self._links[index].send(data, (host, port))

    def _make_estimator(self, sysid: int) -> Estimator:
        writer, folder = None, None
        if self._out is not None:
            # the first vehicle lies where a replay of the recording puts it
            base = self._out if not self._watches else self._out / f"vehicle_{sysid}"
            folder = base / self._config.filter
            writer = ResultWriter(folder, self._config.states.layout())
            write_text(folder / "config.yaml", to_yaml(self._config))
        self._watches[sysid] = Watch(LiveTruth(), writer, folder, Counter(), time.monotonic())
        if writer is None:
            return Estimator(self._config, self._config.filter)
        outputs = Outputs(grid_us(ROWS_PER_SECOND), writer.write_rows, writer.write_decision)
        return Estimator(self._config, self._config.filter, outputs)

    def _make_store(self, vehicle: Vehicle) -> ConfigStore:
        """A vehicle's own parameters; they begin with the service's configuration."""

        def apply(config: Config) -> None:
            tune(vehicle.intake, config)
            vehicle.set_rates(config.streams)

        return ConfigStore(self._config, apply, file_keeper(self._config_path), not_ready)

    def _write_rows(self) -> None:
        """Write the rows that are held, a few at a time: a second's worth would hold up a sample on its way."""
        for sysid, watch in self._watches.items():
            if watch.writer is not None:
                self.session.vehicles[sysid].estimator.flush()

    def _flush(self) -> None:
        """Bring what is written to the files, so that a crash loses a second at most."""
        for watch in self._watches.values():
            if watch.writer is not None:
                watch.writer.flush()
        if self._recorder is not None:
            self._recorder.flush()
        if self._signing is not None:
            self._signing.keep(self._now_us())

    def snapshot(self, now: float) -> StatusSnapshot:
        """The service as the live status shows it."""
        return StatusSnapshot(
            uptime=now - self._started,
            peers=len(self.session.peers),
            packets_in=self.session.packets_in,
            packets_out=self.session.packets_out,
            dropped=self._dropped(),
            remarks=self.session.asking.remarks,
            vehicles=tuple(self._vehicle_status(v, now) for v in self.session.vehicles.values()),
            pid=os.getpid(),
        )

    def _vehicle_status(self, vehicle: Vehicle, now: float) -> VehicleStatus:
        watch = self._watches[vehicle.sysid]
        counts = vehicle.intake.counts
        elapsed = max(now - watch.counted_at, 1e-3)
        rates = {name: (n - watch.counts_before[name]) / elapsed for name, n in counts.items()}
        watch.counts_before, watch.counted_at = Counter(counts), now
        estimator = vehicle.estimator
        solution = estimator.solution()
        autopilot = self.session.asking.autopilots.get(vehicle.sysid)
        return VehicleStatus(
            sysid=vehicle.sysid,
            health=estimator.health.name.lower(),
            reason=vehicle.silence(self._now_us()) or estimator.reason,
            t_us=estimator.t_us or 0,
            estimate=None if solution is None else estimate_status(solution),
            rates=rates,
            aidings={name: aiding_status(s) for name, s in estimator.statistics.items()},
            reset_counter=estimator.reset_counter,
            error=watch.truth.last if solution is not None else None,
            monitor=None if vehicle.monitor is None else vehicle.monitor.status(),
            clock_offset=None if autopilot is None else autopilot.timesync.offset,
            round_trip=None if autopilot is None else autopilot.timesync.round_trip,
        )

    def close(self) -> None:
        """Write what is left, close files and links; what fails does not keep the rest from being closed."""
        with contextlib.ExitStack() as stack:
            for link in self._links:
                stack.callback(link.close)
            if self._status_socket is not None:
                stack.callback(self._status_socket.close)
            if self._signing is not None:
                stack.callback(self._signing.close)
            if self._recorder is not None:
                stack.callback(self._recorder.close)
            for sysid, watch in self._watches.items():
                stack.callback(self._finish, self.session.vehicles[sysid], watch)

    def _finish(self, vehicle: Vehicle, watch: Watch) -> None:
        """Write the last rows and the summary of a vehicle."""
        vehicle.estimator.finish()
        if watch.writer is not None and watch.folder is not None:
            watch.writer.close()
            write_json(watch.folder.parent / "summary.json", self._summary(vehicle, watch))

    def _summary(self, vehicle: Vehicle, watch: Watch) -> dict[str, Any]:
        truth = watch.truth.summary()
        autopilot = self.session.asking.autopilots.get(vehicle.sysid)
        return {
            "mavins": __version__,
            "filter": self._config.filter,
            "sysid": vehicle.sysid,
            **summarize(vehicle.estimator, vehicle.intake),
            **({} if truth is None else {"truth": truth}),
            "rows": watch.writer.rows if watch.writer is not None else 0,
            **({} if autopilot is None else {"asking": autopilot.summary()}),
            "service": {
                "packets_in": self.session.packets_in,
                "packets_out": self.session.packets_out,
                "dropped": self._dropped(),
            },
            "wall_s": time.monotonic() - self._started,
            "cpu_s": time.process_time() - self._cpu_started,
        }
