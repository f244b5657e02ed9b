"""A log through the estimator: the same way as live, only faster."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from mavins import __version__
from mavins.config import Config
from mavins.estimates import Decisions, Estimates, Result
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.feed import Feed
from mavins.estimator.fusion import Event
from mavins.estimator.history import History
from mavins.estimator.smoothing import smooth as smooth_back
from mavins.evaluation.errors import ErrorSums
from mavins.filters.base import RowBlock
from mavins.logs.truth import Truth
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import Layout
from mavins.results import BIAS_SIGMAS, further, table_of
from mavins.sources import Log, Source, judge_of, open_log
from mavins.types import FloatArray, IntArray

_JUDGED_TOGETHER: Final = 4096
"""Rows that are held against a truth at once."""


class Sink(Protocol):
    """Takes what a run says while it runs (results.ResultWriter writes it)."""

    def write_table(self, t_us: IntArray, table: FloatArray) -> None:
        """Estimates (N, 37 + k) as `results.table_of` makes them."""

    def write_decision(self, event: Event) -> None:
        """The final decision on a measurement."""


def grid_us(rate: float) -> int:
    """The output grid in us for a rate in Hz; 0 for every IMU sample."""
    return 0 if rate <= 0.0 else max(1, round(1e6 / rate))


def run(
    log: Log | Path | str,
    config: Config | None = None,
    *,
    start: float | None = None,
    end: float | None = None,
    rate: float = 50.0,
    smooth: bool = False,
    progress: Callable[[float], None] = lambda _: None,
) -> Result:
    """Run a log through the estimator of a configuration (None: the defaults).

    The whole log is filtered; `start` and `end`, in s on the vehicle's boot clock, bound what is kept and judged, at
    `rate` in Hz (0: every IMU sample). `smooth` adds estimates that know what came later. `progress` is told the share
    that is done. Raises LogFormatError for what is not a log with an IMU.
    """
    opened = log if isinstance(log, Log) else open_log(log)
    source = opened.source(config or Config())
    return run_source(source, opened.path, start, end, rate, smooth, (), progress)


def run_source(
    source: Source,
    path: Path,
    start: float | None,
    end: float | None,
    rate: float,
    smooth: bool,
    sinks: Sequence[Sink],
    progress: Callable[[float], None],
    before: Callable[[Estimator], Feed] = lambda estimator: estimator,
    keep: bool = True,
) -> Result:
    """`run` for a source that was opened from `path`; what lies within the bounds goes to the sinks as it comes.

    `before` puts what looks on between the source and the estimator. Without `keep` the result has its summary, but
    neither estimates nor innovations: those of hours are larger than the log.
    """
    config = source.config
    bounds = (round((start or 0.0) * 1e6), 2**62 if end is None else round(end * 1e6))
    judges = {"reference": source.reference, "truth": source.truth}
    known = {key: judge for key, judge in judges.items() if judge is not None and len(judge) > 1}
    recorder = _Recorder(config.states.layout(), bounds, sinks, known, keep)
    history = History() if smooth else None
    outputs = Outputs(grid_us(rate), recorder.take_rows, recorder.take_decision, history)
    estimator = Estimator(config, config.filter, outputs)
    source.feed(before(estimator), progress)
    estimator.finish()
    estimates = recorder.estimates()
    summary: dict[str, Any] = {"mavins": __version__, "log": str(path)}
    summary |= {"filter": config.filter, **source.summary(estimator)}
    judge = judge_of(source)
    for key, sums in recorder.errors().items() if recorder.rows else ():
        summary[key] = {"source": known[key].source, **sums.summary()}
    errors = estimates.against(judge) if judge is not None and len(estimates) else None
    smoothed = None if history is None else _smoothed(estimator, history, bounds)
    if smoothed is not None and judge is not None and len(smoothed):
        summary["smoothed"] = smoothed.against(judge).summary()
    summary |= {"log_s": source.seconds, "rows": recorder.rows, "damage": source.damage}
    return Result(
        estimates.t_us,
        estimates.table,
        estimates.further,
        config,
        recorder.decisions.by_aiding(),
        source.truth,
        source.reference,
        errors,
        smoothed,
        summary,
    )


class _Recorder:
    """Hands on what lies within bounds, judges it, and keeps it if it is to be kept."""

    def __init__(
        self,
        layout: Layout,
        bounds: tuple[int, int],
        sinks: Sequence[Sink],
        judges: Mapping[str, Truth],
        keep: bool,
    ) -> None:
        self._layout, self._bounds, self._sinks = layout, bounds, sinks
        self._judges, self._keep = judges, keep
        self._tables: list[tuple[IntArray, FloatArray]] = []
        self._unjudged: list[tuple[IntArray, FloatArray]] = []
        self._errors = {name: ErrorSums() for name in judges}
        self.rows = 0
        self.decisions = Decisions()

    def take_rows(self, block: RowBlock, frame: TangentFrame) -> None:
        t_us, table = _within(self._bounds, block, frame, self._layout)
        if not len(t_us):
            return
        self.rows += len(t_us)
        if self._keep:
            self._tables.append((t_us, table))
        self._unjudged.append((t_us, table))
        if sum(len(t) for t, _ in self._unjudged) >= _JUDGED_TOGETHER:
            self._judge()
        for sink in self._sinks:
            sink.write_table(t_us, table)

    def take_decision(self, event: Event) -> None:
        if not self._bounds[0] <= event.measurement.t_us <= self._bounds[1]:
            return
        if self._keep:
            self.decisions.keep(event)
        for sink in self._sinks:
            sink.write_decision(event)

    def estimates(self) -> Estimates:
        return _joined(self._tables, self._layout)

    def errors(self) -> dict[str, ErrorSums]:
        """Of all rows, by judge."""
        self._judge()
        return self._errors

    def _judge(self) -> None:
        estimates = _joined(self._unjudged, self._layout)
        self._unjudged.clear()
        for name, judge in self._judges.items():
            if len(estimates):
                self._errors[name].add(estimates.against(judge))


def _within(
    bounds: tuple[int, int], block: RowBlock, frame: TangentFrame, layout: Layout
) -> tuple[IntArray, FloatArray]:
    """The stamps and the table of a block's rows within the bounds."""
    t_us, table = block.t_us[: block.count], table_of(block, frame, layout)
    inside = (t_us >= bounds[0]) & (t_us <= bounds[1])
    return t_us[inside], table[inside]


def _smoothed(estimator: Estimator, history: History, bounds: tuple[int, int]) -> Estimates:
    """A finished run, smoothed."""
    layout = estimator.filter.layout
    tables = [_within(bounds, block, frame, layout) for block, frame in smooth_back(history)]
    return _joined(tables[::-1], layout)


def _joined(tables: Sequence[tuple[IntArray, FloatArray]], layout: Layout) -> Estimates:
    places = further(layout)
    width = max((sigmas.stop for _, sigmas in places.values()), default=BIAS_SIGMAS.stop)
    if len(tables) == 1:
        return Estimates(*tables[0], places)
    t_us = np.concatenate([np.empty(0, dtype=np.int64), *(t for t, _ in tables)])
    table = np.concatenate([np.empty((0, width)), *(table for _, table in tables)])
    return Estimates(t_us, table, places)
