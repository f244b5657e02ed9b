"""A log through the estimator into a result folder: the same way as live, only faster."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavins import __version__
from mavins.config import Config, to_yaml
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.solution import EULER, LLA, V_L
from mavins.evaluation.errors import errors_against
from mavins.logs.tlog import read_tlog
from mavins.logs.truth import truth_of
from mavins.mavlink.codec import IMU_KINDS, Frames
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.results import ResultWriter, write_json, write_text

CHUNK = 20_000
"""Packets between two reports of progress."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What of the log is written and judged: `start`, `end` in s on the vehicle's boot clock, `rate` in Hz (0: every
    IMU sample), `sysid` None for the first vehicle that sends an IMU."""

    start: float | None = None
    end: float | None = None
    rate: float = 50.0
    sysid: int | None = None


def vehicle_of(frames: Frames) -> int:
    """The first sysid that sends an IMU."""
    at = np.flatnonzero(np.isin(frames.msgid, list(IMU_KINDS)))
    if not len(at):
        raise LogFormatError(
            "the log has no IMU messages (HIGHRES_IMU, SCALED_IMU, RAW_IMU): nothing to estimate from; "
            "see what it holds with: mavins info LOG"
        )
    return int(frames.sysid[at[0]])


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
    """Run a log through the estimator, write the result folder, return the summary.

    Raises LogFormatError for what is not a log with an IMU, OutputError where `out` cannot be written.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    frames = read_tlog(log)
    sysid = vehicle_of(frames) if options.sysid is None else options.sysid
    mine = frames.select((frames.sysid == sysid) & np.isin(frames.msgid, RELEVANT))
    bounds = (
        round((options.start or 0.0) * 1e6),
        2**62 if options.end is None else round(options.end * 1e6),
    )
    folder = out / config.filter
    with ResultWriter(folder, keep=True) as writer:
        writer.bounds_us = bounds
        outputs = Outputs(grid_us(options.rate), writer.write_rows, writer.write_decision)
        estimator = Estimator(config, config.filter, outputs)
        intake = Intake(estimator, config.sources)
        for start in range(0, len(mine), CHUNK):
            intake.take(mine.select(np.arange(start, min(start + CHUNK, len(mine)))))
            progress(min(start + CHUNK, len(mine)) / max(1, len(mine)))
        estimator.finish()
    if intake.imu is None:
        raise LogFormatError(f"the log has no usable IMU messages of vehicle {sysid}")
    write_text(folder / "config.yaml", to_yaml(config))
    t_us, rows = writer.table()
    summary = summarize(estimator, intake)
    summary = {
        "mavins": __version__,
        "log": str(log),
        "filter": config.filter,
        "sysid": sysid,
        **summary,
    }
    truth = truth_of(frames, sysid)
    if truth is not None and len(truth) > 1 and len(t_us):
        table = (
            truth.t_us,
            np.column_stack([truth.lat, truth.lon, truth.alt]),
            truth.v_l,
            truth.q_lb,
        )
        judged = errors_against(t_us, rows[:, LLA], rows[:, V_L], rows[:, EULER], table)
        summary["truth"] = {"source": truth.source, **judged.summary()}
    covered = (int(frames.t_us[-1]) - int(frames.t_us[0])) * 1e-6
    summary["log_s"] = covered
    summary["rows"] = writer.rows
    summary["damage"] = {
        name: getattr(frames.damage, name)
        for name in ("bad_crc", "unknown", "skipped_bytes", "truncated")
    }
    summary["wall_s"] = time.perf_counter() - wall
    summary["cpu_s"] = time.process_time() - cpu
    summary["times_real_time"] = covered / summary["cpu_s"]
    write_json(out / "summary.json", summary)
    return summary


def summarize(estimator: Estimator, intake: Intake) -> dict[str, Any]:
    """What a run saw and decided: messages, drops, aidings with their innovation statistics, health."""
    return {
        "imu": None
        if intake.imu is None
        else {"message": IMU_KINDS[intake.imu[0]], "id": intake.imu[1]},
        "messages": dict(intake.counts),
        "dropped": {k: v for k, v in (intake.dropped + estimator.dropped).items() if v},
        "imu_samples": estimator.imu_rows,
        "aiding": {name: s.summary() for name, s in estimator.statistics.items()},
        "health": estimator.health.name.lower(),
        "reason": estimator.reason,
        "resets": estimator.reset_counter,
        "realignments": estimator.realignments,
    }
