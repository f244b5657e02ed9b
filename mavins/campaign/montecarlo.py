"""A Monte-Carlo series: a scenario flown many times, each time with other errors, through each of several filters.

Theory: docs/theory/consistency.md. Tutorial: docs/tutorials/monte-carlo.md.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mavins.campaign.vary import Spread, drawn, varied
from mavins.campaign.workers import LOST, Workers, ready, spread
from mavins.config import Config
from mavins.errors import MavinsError
from mavins.evaluation.compare import SECOND_US, SETTLED_US, Run, consistency, converged_after
from mavins.evaluation.compare import run as run_filter
from mavins.evaluation.consistency import band
from mavins.evaluation.errors import Errors
from mavins.examples.scenarios import flight
from mavins.types import FloatArray, IntArray
from sitl.scenario import Scenario

QUANTITIES: Final = ("horizontal_m", "vertical_m", "speed_m_s", "tilt_deg", "yaw_deg")
"""What is judged: how far off horizontally and vertically, the velocity, roll and pitch together, and the yaw."""
OF_INSTANTS: Final = (50.0, 68.0, 95.0, 99.7)
OF_RUNS: Final = (5.0, 50.0, 95.0)
"""Percentiles over the instants of all runs, and over the runs' RMS."""


@dataclass(frozen=True, slots=True)
class Series:
    """A scenario for so many s, flown `runs` times from a seed on, and how the filters are set."""

    scenario: Scenario
    config: Config
    filters: tuple[str, ...]
    runs: int
    duration: float
    seed: int
    spreads: tuple[Spread, ...] = ()


@dataclass(frozen=True, slots=True)
class Job:
    """One run of a series."""

    run: int
    seed: int
    drawn: Mapping[str, Any]
    scenario: Scenario
    config: Config
    filters: tuple[str, ...]
    duration: float


@dataclass(frozen=True, slots=True)
class Flown:
    """One filter in one run.

    Sizes of errors (M, 5), as QUANTITIES names them, at the seconds `t_us` (M,); `rms` and `largest` (5,) over all rows
    since it has settled, SETTLED_US after the first estimate. `nis` is (sum, rows) by aiding.
    """

    run: int
    seed: int
    drawn: Mapping[str, Any]
    filter: str
    t_us: IntArray
    sizes: FloatArray
    rms: FloatArray
    largest: FloatArray
    nees_us: IntArray
    nees: FloatArray
    nis: Mapping[str, tuple[float, int]]
    refused: Mapping[tuple[str, str], int]
    converged_s: float
    health: str
    reason: str
    resets: int
    simulation_cpu_s: float
    filter_cpu_s: float


def jobs_of(series: Series) -> list[Job]:
    """The runs of a series, each with what is drawn for it; ConfigError where that is not allowed."""
    jobs = []
    for run in range(series.runs):
        values = drawn(series.spreads, series.seed, run)
        scenario, config = varied(series.scenario, series.config, values)
        seed = series.seed + run
        jobs.append(Job(run, seed, values, scenario, config, series.filters, series.duration))
    return jobs


def fly(job: Job) -> tuple[Flown, ...]:
    """Fly one run through its filters."""
    for name in job.filters:
        ready(name)
    began = time.process_time()
    tape, truth = flight(job.config, job.scenario, job.seed, job.duration)
    cpu_s = time.process_time() - began
    flown = []
    for name in job.filters:
        began = time.process_time()
        run = run_filter(name, job.config, tape, truth)
        flown.append(_kept(job, run, cpu_s, time.process_time() - began))
    return tuple(flown)


def montecarlo(
    series: Series, workers: Workers, progress: Callable[[float], None] = lambda _: None
) -> list[Flown]:
    """All runs of a series, in their order, whoever flew them."""
    for name in series.filters:
        ready(name)
    jobs = jobs_of(series)
    found: dict[int, tuple[Flown, ...]] = {}
    with closing(spread(fly, jobs, workers)) as outcomes:
        for k, flown in outcomes:
            if flown is None:
                raise MavinsError(f"run {k} (seed {jobs[k].seed}) could not be flown: {LOST}")
            found[k] = flown
            progress(len(found) / len(jobs))
    return [flown for k in sorted(found) for flown in found[k]]


def figures_of(flown: Sequence[Flown]) -> dict[str, Any]:
    """What the runs of one filter say together."""
    settled = [f.sizes[_late(f.t_us)] for f in flown]
    instants = np.concatenate([np.empty((0, len(QUANTITIES))), *settled])
    rms = np.array([f.rms for f in flown])
    converged = np.array([f.converged_s for f in flown])
    nis = {}
    for name in sorted({name for f in flown for name in f.nis}):
        sums = [f.nis.get(name, (0.0, 0)) for f in flown]
        rows = sum(n for _, n in sums)
        if rows:
            mean = math.fsum(s for s, _ in sums) / rows
            nis[name] = {"mean": mean, "band": list(band(1, rows)), "rows": rows}
    refused: dict[str, Counter[str]] = {}
    for f in flown:
        for (aiding, reason), n in f.refused.items():
            refused.setdefault(aiding, Counter())[reason] += n
    return {
        "runs": len(flown),
        "health": dict(sorted(Counter(f.health for f in flown).items())),
        "resets": sum(f.resets for f in flown),
        "percentiles": _percentiles(instants, OF_INSTANTS),
        "rms_of_runs": _percentiles(rms, OF_RUNS),
        "largest": dict(
            zip(QUANTITIES, _highest(np.array([f.largest for f in flown])), strict=True)
        ),
        **consistency([(f.nees_us, f.nees) for f in flown]),
        "nis": nis,
        "refused": {name: dict(sorted(n.items())) for name, n in sorted(refused.items())},
        "convergence_s": _percentile(converged, (50.0, 95.0)),
        "never_converged": int(np.count_nonzero(np.isnan(converged))),
    }


def _kept(job: Job, run: Run, simulation_cpu_s: float, filter_cpu_s: float) -> Flown:
    """What is kept of a run: few numbers, for there are many runs."""
    nothing = np.full(len(QUANTITIES), np.nan)
    t_us, sizes, rms, largest = np.empty(0, np.int64), np.empty((0, 5)), nothing, nothing
    converged_s = math.nan
    if run.errors is not None and len(run.errors.t_us):
        every, all_sizes = run.errors.t_us, sizes_of(run.errors)
        converged_s = converged_after(run.errors)
        late = all_sizes[_late(every)]
        if len(late):
            rms, largest = np.sqrt(np.mean(late**2, axis=0)), late.max(axis=0)
        _, first = np.unique(every // SECOND_US, return_index=True)
        t_us, sizes = every[first], all_sizes[first]
    return Flown(
        job.run,
        job.seed,
        job.drawn,
        run.filter,
        t_us,
        sizes,
        rms,
        largest,
        run.nees_us,
        run.nees,
        run.nis,
        run.refused,
        converged_s,
        run.health,
        run.reason,
        run.resets,
        simulation_cpu_s,
        filter_cpu_s,
    )


def sizes_of(errors: Errors) -> FloatArray:
    """Sizes (N, 5) of errors, as QUANTITIES names them."""
    att = np.degrees(errors.att)
    return np.column_stack(
        [
            np.hypot(errors.pos[:, 0], errors.pos[:, 1]),
            np.abs(errors.pos[:, 2]),
            np.linalg.norm(errors.vel, axis=1),
            np.hypot(att[:, 0], att[:, 1]),
            np.abs(att[:, 2]),
        ]
    )


def _late(t_us: IntArray) -> Any:
    """Which instants lie SETTLED_US or more after the first."""
    return t_us >= (t_us[0] + SETTLED_US if len(t_us) else 0)


def _percentile(values: FloatArray, shares: Sequence[float]) -> dict[str, float | None]:
    known = values[np.isfinite(values)]
    found = np.percentile(known, shares).tolist() if len(known) else [None] * len(shares)
    return {f"{share:g}": value for share, value in zip(shares, found, strict=True)}


def _percentiles(sizes: FloatArray, shares: Sequence[float]) -> dict[str, Any]:
    return {name: _percentile(sizes[:, k], shares) for k, name in enumerate(QUANTITIES)}


def _highest(sizes: FloatArray) -> list[float | None]:
    known = [column[np.isfinite(column)] for column in sizes.T]
    return [float(column.max()) if len(column) else None for column in known]
