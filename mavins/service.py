"""The service: sockets in front of a session, result files and a status behind it."""

from __future__ import annotations

import contextlib
import select
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
from mavins.logs.tlog import TlogWriter
from mavins.mavlink.session import Session
from mavins.mavlink.vehicle import Vehicle
from mavins.replay import grid_us, summarize
from mavins.results import ResultWriter, check_folder, write_json, write_text
from mavins.snapshot import aiding_status, estimate_status
from mavins.status import StatusSnapshot, VehicleStatus
from mavins.transports.base import Transport
from mavins.transports.udp import UdpTransport

TICK_S: Final = 0.05
STATUS_S: Final = 1.0
ROWS_PER_SECOND: Final = 50.0

Address = tuple[int, str, int]
"""Which of our links, and the host and port at its other end."""


def is_local(address: Hashable) -> bool:
    """True for an address on this host."""
    return isinstance(address, tuple) and str(address[1]).startswith("127.")


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
    """Moves datagrams between links and a session until told to stop."""

    def __init__(
        self,
        config: Config,
        links: Sequence[UdpTransport],
        gcs: Sequence[tuple[str, int]] = (),
        out: Path | None = None,
        record: Path | None = None,
        status: Callable[[StatusSnapshot], None] | None = None,
    ) -> None:
        self._config = config
        self._links: Sequence[Transport] = links
        self._out = out
        self._status = status
        self._watches: dict[int, Watch] = {}
        self._recorder = TlogWriter(record) if record is not None else None
        self._unix_offset_us = time.time_ns() // 1000 - time.monotonic_ns() // 1000
        self._started = time.monotonic()
        self._cpu_started = time.process_time()
        self.session = Session(
            config.mavlink,
            config.streams,
            config.sources,
            self._make_estimator,
            is_local,
            self._recorder,
            self._transmit,
            config.asking,
        )
        for host, port in gcs:
            self.session.add_peer((0, host, port))

    def run(self, stopped: Callable[[], bool]) -> None:
        """Serve until `stopped()`; then close every file whole."""
        poller = select.poll()
        by_fd = {}
        for index, link in enumerate(self._links):
            assert isinstance(link, UdpTransport)
            poller.register(link.fileno(), select.POLLIN)
            by_fd[link.fileno()] = index
        next_tick = next_status = time.monotonic()
        try:
            while not stopped():
                for fd, _ in poller.poll(max(0.0, next_tick - time.monotonic()) * 1e3):
                    self._drain(by_fd[fd])
                now = time.monotonic()
                if now >= next_tick:
                    next_tick = now + TICK_S
                    self.session.tick(self._now_us())
                    self._write_rows()
                if now >= next_status:
                    next_status = now + STATUS_S
                    self._flush()
                    if self._status is not None:
                        self._status(self.snapshot(now))
        finally:
            self.close()

    def _now_us(self) -> int:
        """Microseconds since 1970 that never step back."""
        return self._unix_offset_us + time.monotonic_ns() // 1000

    def _drain(self, index: int) -> None:
        """Take every datagram that waits at a link, answering after each."""
        for data, (host, port) in self._links[index].recv(0.0):
            frames = self.session.receive(data, (index, host, port), self._now_us())
            if HIL_STATE not in frames.msgid:
                continue
            for sysid, vehicle in self.session.vehicles.items():
                self._watches[sysid].truth.take(frames, sysid, vehicle.estimator.solution())

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

    def snapshot(self, now: float) -> StatusSnapshot:
        """The service as the live status shows it."""
        return StatusSnapshot(
            uptime=now - self._started,
            peers=len(self.session.peers),
            packets_in=self.session.packets_in,
            packets_out=self.session.packets_out,
            dropped={k: v for k, v in self.session.dropped.items() if v},
            remarks=self.session.asking.remarks,
            vehicles=tuple(self._vehicle_status(v, now) for v in self.session.vehicles.values()),
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
            clock_offset=None if autopilot is None else autopilot.timesync.offset,
            round_trip=None if autopilot is None else autopilot.timesync.round_trip,
        )

    def close(self) -> None:
        """Write what is left, close files and links; what fails does not keep the rest from being closed."""
        with contextlib.ExitStack() as stack:
            for link in self._links:
                stack.callback(link.close)
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
                "dropped": dict(self.session.dropped),
            },
            "wall_s": time.monotonic() - self._started,
            "cpu_s": time.process_time() - self._cpu_started,
        }
