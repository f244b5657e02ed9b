"""A run of a log, kept: the result folder, whole or not at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mavins import exports
from mavins.config import Config, to_yaml
from mavins.estimates import Result
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Feed
from mavins.evaluation.evidence import FILE, write_evidence
from mavins.logs.sensor_log import DEFAULT, Choice
from mavins.output_tlog import OutputLog
from mavins.results import (
    BIAS_SIGMAS,
    FILES,
    REPORT,
    SUMMARY,
    EstimatesFile,
    ResultWriter,
    write_json,
    write_text,
)
from mavins.runs import run_source
from mavins.sources import source_of
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


def replay(
    log: Path,
    out: Path,
    config: Config,
    options: ReplayOptions,
    progress: Callable[[float], None] = lambda _: None,
    finish: Callable[[Result, Path], None] | None = None,
) -> dict[str, Any]:
    """Run a log of any kind through the estimator, write the result folder, return the summary.

    `finish` is handed the result and its folder, before that takes the place of `out`. Raises LogFormatError for what
    is not a log with an IMU, OutputError where `out` cannot be written.
    """
    own = [REPORT, *(f"{config.filter}/{name}" for name in (*FILES, *exports.FILES))]
    with written_whole(out, SUMMARY, own) as aside:
        result = _replay(log, aside, config, options, progress)
        exports.write_exports(result, options.exports, aside / config.filter)
        if finish is not None:
            finish(result, aside)
    return dict(result.summary)


def _replay(
    log: Path,
    out: Path,
    config: Config,
    options: ReplayOptions,
    progress: Callable[[float], None],
) -> Result:
    wall, cpu = time.perf_counter(), time.process_time()
    source = source_of(log, config, options.sysid, options.choice)
    folder, o = out / config.filter, options
    with ExitStack() as stack:

        def before(estimator: Estimator) -> Feed:
            if exports.TLOG not in o.exports:
                return estimator
            who, path = source.speaker(), folder / exports.OUTPUT_TLOG
            feed = OutputLog(path, estimator, source.config, *who, source.received_us)
            stack.callback(feed.close)
            return feed

        writer = stack.enter_context(ResultWriter(folder, config.states.layout()))
        result = run_source(source, log, o.start, o.end, o.rate, o.smooth, progress, writer, before)
    write_text(folder / "config.yaml", to_yaml(result.config))
    assert result.evidence is not None
    write_evidence(folder / FILE, result.evidence, result.table[:, BIAS_SIGMAS])
    if result.smoothed is not None:
        file = EstimatesFile(folder / "smoothed.csv", result.smoothed.layout)
        file.write(result.smoothed.t_us, result.smoothed.table)
        file.close()
    summary = dict(result.summary)
    summary["wall_s"] = time.perf_counter() - wall
    summary["cpu_s"] = time.process_time() - cpu
    summary["times_real_time"] = summary["log_s"] / summary["cpu_s"]
    write_json(out / SUMMARY, summary)
    return replace(result, summary=summary)
