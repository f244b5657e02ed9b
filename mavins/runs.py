"""A log through the estimator: the same way as live, only faster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mavins import __version__
from mavins.config import Config
from mavins.estimates import Estimates, Result, by_aiding
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.feed import Feed
from mavins.estimator.fusion import Event
from mavins.estimator.history import History
from mavins.estimator.smoothing import smooth as smooth_back
from mavins.evaluation.errors import Errors
from mavins.evaluation.witness import Witness
from mavins.filters.base import RowBlock
from mavins.logs.truth import judge_of
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import Layout
from mavins.results import Decisions, ResultWriter, table_of, width
from mavins.sources import Log, Source, open_log
from mavins.types import FloatArray, IntArray


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
    return run_source(source, opened.path, start, end, rate, smooth, progress)


def run_source(
    source: Source,
    path: Path,
    start: float | None,
    end: float | None,
    rate: float,
    smooth: bool,
    progress: Callable[[float], None],
    writer: ResultWriter | None = None,
    before: Callable[[Estimator], Feed] = lambda estimator: estimator,
) -> Result:
    """`run` for a source that was opened from `path`; what is kept goes to the writer.

    `before` puts what looks on between the source and the estimator.
    """
    config = source.config
    bounds = (round((start or 0.0) * 1e6), 2**62 if end is None else round(end * 1e6))
    recorder = _Recorder(config.states.layout(), bounds, writer)
    history = History() if smooth else None
    outputs = Outputs(grid_us(rate), recorder.take_rows, recorder.take_decision, history)
    estimator = Estimator(config, config.filter, outputs)
    witness = Witness(before(estimator))
    source.feed(witness, progress)
    estimator.finish()
    if writer is not None:
        writer.write_decisions(recorder.decisions)
    estimates = recorder.estimates()
    evidence = witness.evidence(source.truth, source.reference)
    summary: dict[str, Any] = {"mavins": __version__, "log": str(path)}
    summary |= {"filter": config.filter, **source.summary(estimator)}
    errors: Errors | None = None
    for key, known in (("reference", source.reference), ("truth", source.truth)):
        if known is not None and len(known) > 1 and len(estimates):
            errors = estimates.against(known)
            summary[key] = {"source": known.source, **errors.summary()}
    smoothed = None if history is None else _smoothed(estimator, history, bounds)
    judge = judge_of(source.truth, source.reference)
    if smoothed is not None and len(smoothed) and judge is not None and len(estimates):
        summary["smoothed"] = smoothed.against(judge).summary()
    summary |= {"log_s": source.seconds, "rows": len(estimates), "damage": source.damage}
    return Result(
        estimates.t_us,
        estimates.table,
        estimates.layout,
        config,
        by_aiding(recorder.decisions.arrays()),
        evidence,
        errors or None,
        smoothed,
        summary,
    )


class _Recorder:
    """Keeps what lies within bounds, and hands it on."""

    def __init__(
        self, layout: Layout, bounds: tuple[int, int], writer: ResultWriter | None
    ) -> None:
        self._layout, self._bounds, self._writer = layout, bounds, writer
        self._tables: list[tuple[IntArray, FloatArray]] = []
        self.decisions = Decisions()

    def take_rows(self, block: RowBlock, frame: TangentFrame) -> None:
        t_us, table = _within(self._bounds, block, frame, self._layout)
        if not len(t_us):
            return
        self._tables.append((t_us, table))
        if self._writer is not None:
            self._writer.write_table(t_us, table)

    def take_decision(self, event: Event) -> None:
        if self._bounds[0] <= event.measurement.t_us <= self._bounds[1]:
            self.decisions.keep(event)

    def estimates(self) -> Estimates:
        return _joined(self._tables, self._layout)


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
    t_us = np.concatenate([np.empty(0, dtype=np.int64), *(t for t, _ in tables)])
    nothing = np.empty((0, width(layout)))
    return Estimates(t_us, np.concatenate([nothing, *(table for _, table in tables)]), layout)
