"""A log through the estimator into a result folder: the same way as live, only faster."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mavins import __version__
from mavins.config import Config, to_yaml
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.feed import Feed
from mavins.estimator.history import History
from mavins.estimator.smoothing import smooth
from mavins.estimator.solution import EULER, LLA, V_L, WIDTH
from mavins.evaluation.errors import errors_against
from mavins.evaluation.tape import Tape
from mavins.logs.csv_feed import feed_folder, settled
from mavins.logs.csv_folder import read_csv_folder
from mavins.logs.tlog import read_tlog
from mavins.logs.truth import Truth, truth_of
from mavins.mavlink.asking import SPOKEN
from mavins.mavlink.codec import IMU_KINDS, Frames, OriginRequest, decode
from mavins.mavlink.commands import (
    COMMAND_INT,
    COMMAND_LONG,
    STORE_PARAMETERS,
    Command,
    carry_out,
    keep_parameters,
)
from mavins.mavlink.identity import identity_for
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.mavlink.parameters import PARAM_SET, set_again
from mavins.mavlink.peers import Identity
from mavins.mavlink.requests import SET_GPS_GLOBAL_ORIGIN, decode_packet, is_for
from mavins.mavlink.settings import SessionSettings
from mavins.parameters import ConfigStore
from mavins.results import EstimatesFile, ResultWriter, write_json, write_text
from mavins.types import FloatArray, IntArray, Origin

CHANGES = np.array([SET_GPS_GLOBAL_ORIGIN, COMMAND_INT, COMMAND_LONG, PARAM_SET])
"""What others may have asked of us, which a recording holds only where it was carried out."""
CHUNK = 20_000
"""Packets between two reports of progress."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What of the log is written and judged: `start`, `end` in s on the vehicle's boot clock, `rate` in Hz (0: every
    IMU sample), `sysid` None for the first vehicle that sends an IMU; `smooth` adds smoothed.csv."""

    start: float | None = None
    end: float | None = None
    rate: float = 50.0
    sysid: int | None = None
    smooth: bool = False


def vehicle_of(frames: Frames, wanted: int | None = None) -> int:
    """The `wanted` sysid if it sends an IMU, or the first that does; LogFormatError if there is none."""
    senders = frames.sysid[np.isin(frames.msgid, list(IMU_KINDS))]
    if not len(senders):
        raise LogFormatError(
            "the log has no IMU messages (HIGHRES_IMU, SCALED_IMU, RAW_IMU): "
            "nothing to estimate from; see what it holds with: mavins info LOG"
        )
    if wanted is not None and wanted not in senders:
        have = ", ".join(str(sysid) for sysid in np.unique(senders).tolist())
        raise LogFormatError(f"vehicle {wanted} sends no IMU messages in this log; {have} does")
    return int(senders[0]) if wanted is None else wanted


def grid_us(rate: float) -> int:
    """The output grid in us for a rate in Hz; 0 for every IMU sample."""
    return 0 if rate <= 0.0 else max(1, round(1e6 / rate))


def replay(
    log: Path,
    out: Path,
    config: Config,
    options: ReplayOptions,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Run a telemetry log or a folder of CSV files through the estimator, write the result folder, return the summary.

    Raises LogFormatError for what is not a log with an IMU, OutputError where `out` cannot be written.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    source = source_of(log, config, options.sysid)
    config = source.config
    bounds = (
        round((options.start or 0.0) * 1e6),
        2**62 if options.end is None else round(options.end * 1e6),
    )
    folder = out / config.filter
    with ResultWriter(folder, config.states.layout(), keep=True) as writer:
        writer.bounds_us = bounds
        history = History() if options.smooth else None
        grid = grid_us(options.rate)
        outputs = Outputs(grid, writer.write_rows, writer.write_decision, history)
        estimator = Estimator(config, config.filter, outputs)
        source.feed(estimator, progress)
        estimator.finish()
    write_text(folder / "config.yaml", to_yaml(config))
    t_us, rows = writer.table()
    summary: dict[str, Any] = {"mavins": __version__, "log": str(log), "filter": config.filter}
    summary |= source.summary(estimator)
    truth = source.truth
    if truth is not None and len(truth) > 1 and len(t_us):
        summary["truth"] = {"source": truth.source, **_judged(t_us, rows, truth)}
    if history is not None:
        t_us, rows = write_smoothed(folder / "smoothed.csv", estimator, history, bounds)
        if "truth" in summary:
            assert truth is not None
            summary["smoothed"] = _judged(t_us, rows, truth)
    summary["log_s"] = source.seconds
    summary["rows"] = writer.rows
    summary["damage"] = source.damage
    summary["wall_s"] = time.perf_counter() - wall
    summary["cpu_s"] = time.process_time() - cpu
    summary["times_real_time"] = source.seconds / summary["cpu_s"]
    write_json(out / "summary.json", summary)
    return summary


def write_smoothed(
    path: Path, estimator: Estimator, history: History, bounds_us: tuple[int, int]
) -> tuple[IntArray, FloatArray]:
    """Smooth a finished run and write what lies within the bounds; returns stamps (N,) and rows (N, 31)."""
    file = EstimatesFile(path, estimator.filter.layout)
    parts: list[tuple[IntArray, FloatArray]] = []
    for block, frame in smooth(history):
        inside = (block.t_us >= bounds_us[0]) & (block.t_us <= bounds_us[1])
        if inside.any():
            parts.append((block.t_us[inside], file.table(block, frame)[inside]))
    parts.reverse()
    for t_us, table in parts:
        file.write(t_us, table)
    file.close()
    times = [np.empty(0, dtype=np.int64), *(t_us for t_us, _ in parts)]
    rows = [np.empty((0, WIDTH)), *(table[:, :WIDTH] for _, table in parts)]
    return np.concatenate(times), np.concatenate(rows)


def _judged(t_us: IntArray, rows: FloatArray, truth: Truth) -> dict[str, Any]:
    """RMS and largest errors of described rows (N, 31)."""
    truth_columns = truth.columns()
    return errors_against(t_us, rows[:, LLA], rows[:, V_L], rows[:, EULER], truth_columns).summary()


class Source(Protocol):
    """A log of any kind.

    `config` is the configuration with what the log itself decides; `seconds` is the log's length, `damage` what could
    not be read; `truth` is for evaluation only.
    """

    config: Config
    seconds: float
    damage: dict[str, int]
    truth: Truth | None

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """All of the log into an estimator."""

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What was fed, and what the estimator made of it."""


class TlogSource:
    """One vehicle of a telemetry log."""

    def __init__(self, log: Path, config: Config, sysid: int | None) -> None:
        self._frames = frames = read_tlog(log)
        self._sysid = vehicle_of(frames, sysid)
        self.config = config
        self.seconds = (int(frames.t_us[-1]) - int(frames.t_us[0])) * 1e-6
        self.damage = {
            name: getattr(frames.damage, name)
            for name in ("bad_crc", "unknown", "skipped_bytes", "truncated")
        }
        self.truth = truth_of(frames, self._sysid)

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """The vehicle's packets through an intake."""
        sysid = self._sysid
        self._intake = Intake(estimator, self.config.sources)
        store = ConfigStore(self.config, partial(tune, self._intake), keep=lambda config: "")
        who = our_identity(self._frames, sysid, self.config.mavlink)
        _feed(self._intake, store, self._frames, sysid, who, progress)
        if self._intake.imu.chosen is None:
            raise LogFormatError(f"the log has no usable IMU messages of vehicle {sysid}")

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What the intake saw, and what the estimator made of it."""
        return {"sysid": self._sysid, **summarize(estimator, self._intake)}


class FolderSource:
    """A folder of CSV files."""

    def __init__(self, log: Path, config: Config) -> None:
        self._folder = read_csv_folder(log)
        self.config = settled(config, self._folder)
        self.seconds = self._folder.seconds
        self.damage: dict[str, int] = {}
        self.truth = self._folder.truth

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """All tables, merged by their stamps."""
        feed_folder(self._folder, estimator, self.config, progress)

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What the tables hold, and what the estimator made of it."""
        folder, counts = self._folder, self._folder.counts
        return {
            "imu": {"message": "imu.csv", "id": 0},
            "messages": counts,
            "rates_hz": {name: n / max(self.seconds, 1e-6) for name, n in counts.items()},
            "dropped": {k: v for k, v in (folder.dropped + estimator.dropped).items() if v},
            **outcome_of(estimator),
        }


def source_of(log: Path, config: Config, sysid: int | None) -> Source:
    """The source that a path is: a folder of CSV files or a telemetry log."""
    return FolderSource(log, config) if log.is_dir() else TlogSource(log, config, sysid)


def tape_of(
    log: Path,
    config: Config,
    sysid: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Tape, Truth | None]:
    """What an estimator would be fed from a log, with the settings that go with it, and the log's truth."""
    source = source_of(log, config, sysid)
    tape = Tape(source.config)
    source.feed(tape, progress)
    truth = source.truth
    return tape, None if truth is None or len(truth) < 2 else truth


def our_identity(frames: Frames, sysid: int, settings: SessionSettings) -> Identity | None:
    """Under which ids a live session, seeing these packets, speaks about a vehicle; None for one without an IMU."""
    imu_at = np.flatnonzero(np.isin(frames.msgid, list(IMU_KINDS)))
    vehicles, first = np.unique(frames.sysid[imu_at], return_index=True)
    ours: dict[int, Identity] = {}
    for k in np.argsort(first).tolist():
        vehicle = int(vehicles[k])
        taken = {who.sysid for who in ours.values()}
        if vehicle not in taken or settings.persona == "companion":
            before = slice(imu_at[first[k]] + 1)
            told = ~np.isin(frames.msgid[before], SPOKEN)
            seen = set(frames.sysid[before][told].tolist())
            ours[vehicle] = identity_for(vehicle, settings, seen, taken)
    return ours.get(sysid)


def tune(intake: Intake, config: Config) -> None:
    """Put a changed configuration into force, live and again in a replay."""
    intake.reconfigure(config, config.filter, config.sources)


def _feed(
    intake: Intake,
    store: ConfigStore,
    frames: Frames,
    sysid: int,
    who: Identity | None,
    progress: Callable[[float], None],
) -> None:
    """All of a vehicle's packets, and between them what others asked of us, who speak as `who`."""
    relevant = (frames.sysid == sysid) & np.isin(frames.msgid, RELEVANT)
    if who is not None:
        relevant &= (frames.sysid != who.sysid) | (frames.compid != who.compid)
    chosen = frames.select(relevant | np.isin(frames.msgid, CHANGES))
    at = np.flatnonzero(np.isin(chosen.msgid, CHANGES))
    edges = np.unique(np.concatenate([np.arange(0, len(chosen), CHUNK), at, at + 1]))
    for start, end in itertools.pairwise([*edges.tolist(), len(chosen)]):
        if start == end:
            continue
        part = chosen.select(np.arange(start, end))
        if part.msgid[0] not in CHANGES:
            intake.take(part)
        elif who is not None:
            _change(intake.estimator, store, part, who)
        progress(end / len(chosen))


def _change(estimator: Feed, store: ConfigStore, frames: Frames, who: Identity) -> None:
    """Carry out again what was asked of us."""
    if frames.msgid[0] == SET_GPS_GLOBAL_ORIGIN:
        request = decode(frames, 0)
        if isinstance(request, OriginRequest) and request.target_system in (0, who.sysid):
            estimator.set_origin(Origin(request.lat, request.lon, request.alt))
        return
    message = decode_packet(frames, 0)
    if message is None or not is_for(message, who):
        return
    if message.get_msgId() == PARAM_SET:
        set_again(message, store)
        return
    command = Command.of(message)
    if command.number == STORE_PARAMETERS:
        keep_parameters(command, store)
    else:
        carry_out(command, estimator)


def summarize(estimator: Estimator, intake: Intake) -> dict[str, Any]:
    """What a run saw and decided: messages, drops, aidings with their innovation statistics, health."""
    monitor = None if intake.watcher is None else intake.watcher.summary()
    return {
        "imu": None
        if intake.imu.chosen is None
        else {"message": intake.imu.name, "id": intake.imu.chosen[1]},
        "messages": dict(intake.counts),
        "rates_hz": intake.rates(),
        "dropped": {k: v for k, v in (intake.dropped + estimator.dropped).items() if v},
        "reboots": intake.reboots,
        **outcome_of(estimator),
        **({} if monitor is None else {"monitor": monitor}),
    }


def outcome_of(estimator: Estimator) -> dict[str, Any]:
    """What an estimator decided: aidings with their innovation statistics, health, resets."""
    return {
        "imu_samples": estimator.imu_rows,
        "aiding": {name: s.summary() for name, s in estimator.statistics.items()},
        "health": estimator.health.name.lower(),
        "reason": estimator.reason,
        "resets": estimator.reset_counter,
        "realignments": estimator.realignments,
    }
