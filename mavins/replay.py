"""A log through the estimator into a result folder: the same way as live, only faster."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavins import __version__, exports
from mavins.config import Config, to_yaml
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.feed import Feed
from mavins.estimator.history import History
from mavins.estimator.smoothing import smooth
from mavins.estimator.solution import EULER, LLA, V_L, WIDTH
from mavins.evaluation.errors import errors_against
from mavins.evaluation.evidence import FILE, write_evidence
from mavins.evaluation.result_folder import Result, read_result
from mavins.evaluation.witness import Witness
from mavins.logs.sensor_log import DEFAULT, Choice
from mavins.logs.truth import Truth
from mavins.output_tlog import OutputLog
from mavins.results import (
    FILES,
    REPORT,
    SUMMARY,
    EstimatesFile,
    ResultWriter,
    write_json,
    write_text,
)
from mavins.sources import judge_of, source_of
from mavins.types import FloatArray, IntArray
from mavins.whole_folder import written_whole


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What of the log is written and judged: `start`, `end` in s on the vehicle's boot clock, `rate` in Hz (0: every
    IMU sample), `sysid` None for the first vehicle that sends an IMU; `choice` names the log's sources; `smooth` adds
    smoothed.csv, `exports` other formats."""

    start: float | None = None
    end: float | None = None
    rate: float = 50.0
    sysid: int | None = None
    smooth: bool = False
    choice: Choice = DEFAULT
    exports: tuple[str, ...] = ()


def grid_us(rate: float) -> int:
    """The output grid in us for a rate in Hz; 0 for every IMU sample."""
    return 0 if rate <= 0.0 else max(1, round(1e6 / rate))


def replay(
    log: Path,
    out: Path,
    config: Config,
    options: ReplayOptions,
    progress: Callable[[float], None] = lambda _: None,
    finish: Callable[[Result], None] | None = None,
) -> dict[str, Any]:
    """Run a log of any kind through the estimator, write the result folder, return the summary.

    `finish` is handed the result once it is in its folder, before that takes the place of `out`. Raises
    LogFormatError for what is not a log with an IMU, OutputError where `out` cannot be written.
    """
    own = [REPORT, *(f"{config.filter}/{name}" for name in (*FILES, *exports.FILES))]
    with written_whole(out, SUMMARY, own) as aside:
        summary = _replay(log, aside, config, options, progress)
        if options.exports or finish is not None:
            result = read_result(aside)
            exports.write_exports(result, options.exports, aside / config.filter)
            if finish is not None:
                finish(result)
    return summary


def _replay(
    log: Path,
    out: Path,
    config: Config,
    options: ReplayOptions,
    progress: Callable[[float], None],
) -> dict[str, Any]:
    wall, cpu = time.perf_counter(), time.process_time()
    source = source_of(log, config, options.sysid, options.choice)
    config = source.config
    bounds = (
        round((options.start or 0.0) * 1e6),
        2**62 if options.end is None else round(options.end * 1e6),
    )
    folder = out / config.filter
    with ExitStack() as stack:
        writer = stack.enter_context(ResultWriter(folder, config.states.layout(), keep=True))
        writer.bounds_us = bounds
        history = History() if options.smooth else None
        grid = grid_us(options.rate)
        outputs = Outputs(grid, writer.write_rows, writer.write_decision, history)
        estimator = Estimator(config, config.filter, outputs)
        feed: Feed = estimator
        if exports.TLOG in options.exports:
            log_path = folder / exports.OUTPUT_TLOG
            feed = OutputLog(log_path, estimator, config, *source.speaker(), source.received_us)
            stack.callback(feed.close)
        witness = Witness(feed)
        source.feed(witness, progress)
        estimator.finish()
    write_text(folder / "config.yaml", to_yaml(config))
    write_evidence(folder / FILE, witness.evidence(source.truth, source.reference))
    t_us, rows = writer.table()
    summary: dict[str, Any] = {"mavins": __version__, "log": str(log), "filter": config.filter}
    summary |= source.summary(estimator)
    for key, judge in (("truth", source.truth), ("reference", source.reference)):
        if judge is not None and len(judge) > 1 and len(t_us):
            summary[key] = {"source": judge.source, **_judged(t_us, rows, judge)}
    if history is not None:
        t_us, rows = write_smoothed(folder / "smoothed.csv", estimator, history, bounds)
        judge = judge_of(source)
        if judge is not None and len(t_us):
            summary["smoothed"] = _judged(t_us, rows, judge)
    summary["log_s"] = source.seconds
    summary["rows"] = writer.rows
    summary["damage"] = source.damage
    summary["wall_s"] = time.perf_counter() - wall
    summary["cpu_s"] = time.process_time() - cpu
    summary["times_real_time"] = source.seconds / summary["cpu_s"]
    write_json(out / SUMMARY, summary)
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
