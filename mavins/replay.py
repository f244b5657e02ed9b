"""A run of a log, kept: the result folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavins.config import Config, to_yaml
from mavins.estimates import Estimates
from mavins.logs.sensor_log import DEFAULT, Choice
from mavins.nav.layout import Layout
from mavins.results import EstimatesFile, ResultWriter, write_json, write_text
from mavins.runs import run_source
from mavins.sources import source_of


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What of the log is written and judged: `start`, `end` in s on the vehicle's boot clock, `rate` in Hz (0: every
    IMU sample), `sysid` None for the first vehicle that sends an IMU; `choice` names the log's sources; `smooth` adds
    smoothed.csv."""

    start: float | None = None
    end: float | None = None
    rate: float = 50.0
    sysid: int | None = None
    smooth: bool = False
    choice: Choice = DEFAULT


def replay(
    log: Path,
    out: Path,
    config: Config,
    options: ReplayOptions,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Run a log of any kind through the estimator, write the result folder, return the summary.

    Raises LogFormatError for what is not a log with an IMU, OutputError where `out` cannot be written.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    source = source_of(log, config, options.sysid, options.choice)
    folder, layout = out / config.filter, config.states.layout()
    o = options
    with ResultWriter(folder, layout) as writer:
        result = run_source(source, log, o.start, o.end, o.rate, o.smooth, [writer], progress)
    write_text(folder / "config.yaml", to_yaml(result.config))
    if result.smoothed is not None:
        write_estimates(folder / "smoothed.csv", result.smoothed, layout)
    summary = dict(result.summary)
    summary["wall_s"] = time.perf_counter() - wall
    summary["cpu_s"] = time.process_time() - cpu
    summary["times_real_time"] = summary["log_s"] / summary["cpu_s"]
    write_json(out / "summary.json", summary)
    return summary


def write_estimates(path: Path, estimates: Estimates, layout: Layout) -> None:
    """Write estimates as CSV."""
    file = EstimatesFile(path, layout)
    file.write(estimates.t_us, estimates.table)
    file.close()
