"""A run of a log, kept: the result folder, whole or not at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavins import exports
from mavins.config import Config, to_yaml
from mavins.estimates import Estimates
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Feed
from mavins.estimator.fusion import Event
from mavins.evaluation.evidence import FILE, write_evidence
from mavins.evaluation.result_folder import Result, read_result
from mavins.evaluation.witness import Witness
from mavins.logs.sensor_log import DEFAULT, Choice
from mavins.nav.layout import Layout
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
    folder, layout, o = out / config.filter, config.states.layout(), options
    witnesses: list[Witness] = []
    with ExitStack() as stack:

        def before(estimator: Estimator) -> Feed:
            feed: Feed = estimator
            if exports.TLOG in o.exports:
                who, path = source.speaker(), folder / exports.OUTPUT_TLOG
                feed = OutputLog(path, estimator, source.config, *who, source.received_us)
                stack.callback(feed.close)
            witnesses.append(Witness(feed))
            return witnesses[0]

        writer, sigmas = stack.enter_context(ResultWriter(folder, layout)), _BiasSigmas()
        result = run_source(
            source, log, o.start, o.end, o.rate, o.smooth, [writer, sigmas], progress, before, False
        )
    write_text(folder / "config.yaml", to_yaml(result.config))
    evidence = witnesses[0].evidence(source.truth, source.reference)
    write_evidence(folder / FILE, replace(evidence, bias_sigmas=sigmas.table()))
    if result.smoothed is not None:
        write_estimates(folder / "smoothed.csv", result.smoothed, layout)
    summary = dict(result.summary)
    summary["wall_s"] = time.perf_counter() - wall
    summary["cpu_s"] = time.process_time() - cpu
    summary["times_real_time"] = summary["log_s"] / summary["cpu_s"]
    write_json(out / SUMMARY, summary)
    return summary


class _BiasSigmas:
    """Keeps what estimates.csv leaves to evidence.npz, as that has it."""

    def __init__(self) -> None:
        self._parts = [np.empty((0, 6), dtype=np.float32)]

    def write_table(self, t_us: IntArray, table: FloatArray) -> None:
        """Keep the biases' sigmas."""
        self._parts.append(table[:, BIAS_SIGMAS].astype(np.float32))

    def write_decision(self, event: Event) -> None:
        """Nothing of it."""

    def table(self) -> NDArray[np.float32]:
        """All of them (N, 6)."""
        return np.concatenate(self._parts)


def write_estimates(path: Path, estimates: Estimates, layout: Layout) -> None:
    """Write estimates as CSV."""
    file = EstimatesFile(path, layout)
    file.write(estimates.t_us, estimates.table)
    file.close()
