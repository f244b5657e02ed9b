"""Filters side by side on the same samples: one run each, and what the runs say together.

A run is judged against a truth: RMS and largest errors, NEES of the canonical nine errors (p_n, v_n, theta_b) once a
second, NIS per aiding, CPU time, and how long it took to converge. Theory: docs/theory/consistency.md.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.settings import Settings
from mavins.estimator.solution import EULER, LLA, V_L, WIDTH, describe
from mavins.evaluation.consistency import band, errors, nees, share_inside
from mavins.evaluation.errors import Errors, errors_against, interpolate_truth
from mavins.evaluation.tape import Tape
from mavins.filters import RowBlock
from mavins.logs.truth import Truth
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import dcm_to_quat, quat_conj, quat_mul
from mavins.types import FloatArray, IntArray

GRID_US: Final = 20_000
SECOND_US: Final = 1_000_000
SETTLED_US: Final = 30_000_000
"""NEES counts from this long after the first estimate on."""
DOF: Final = 9
CONVERGED_POS: Final = 2.0
CONVERGED_ATT: Final = math.radians(3.0)
CONVERGED_FOR_US: Final = 5_000_000
"""A run has converged once its errors stay below these (m horizontally, rad on each axis) for so long."""


@dataclass(frozen=True, slots=True)
class Run:
    """One filter on one tape.

    `rows` (N, 31) at `t_us` (N,) as solution.describe writes them; `errors` at those of them where there is a truth;
    `nees` (M,) at the seconds `nees_us` (M,) from the first estimate on. `nis` is (sum, rows) per aiding. `fixes` are
    the stamps and places of the GNSS fixes that went in; `refused` counts the measurements that were not fused, by
    (aiding, reason).
    """

    filter: str
    t_us: IntArray
    rows: FloatArray
    errors: Errors | None
    nees_us: IntArray
    nees: FloatArray
    nis: dict[str, tuple[float, int]]
    cpu_s: float
    imu_samples: int
    resets: int
    health: str
    reason: str
    fixes: tuple[IntArray, FloatArray]
    refused: dict[tuple[str, str], int]


def run(
    filter_name: str,
    settings: Settings,
    tape: Tape,
    truth: Truth | None,
    bounds_us: tuple[int, int] = (0, 2**62),
) -> Run:
    """Play a tape to a filter and judge what it says between two bounds."""
    times: list[IntArray] = []
    tables: list[FloatArray] = []
    seconds: list[tuple[TangentFrame, IntArray, FloatArray, FloatArray]] = []

    def take(block: RowBlock, frame: TangentFrame) -> None:
        n = block.count
        t_us = block.t_us[:n].copy()
        rows = np.empty((n, WIDTH))
        describe(block.x[:n], block.P[:n], frame.r0_e, frame.C_ne, rows)
        times.append(t_us)
        tables.append(rows)
        whole = t_us % SECOND_US < GRID_US
        seconds.append((frame, t_us[whole], block.x[:n][whole], block.P[:n][whole]))

    estimator = Estimator(settings, filter_name, Outputs(GRID_US, take))
    began = time.process_time()
    tape.play(estimator)
    cpu_s = time.process_time() - began
    t_us = np.concatenate([np.empty(0, dtype=np.int64), *times])
    rows = np.concatenate([np.empty((0, WIDTH)), *tables])
    inside = (t_us >= bounds_us[0]) & (t_us <= bounds_us[1])
    t_us, rows = t_us[inside], rows[inside]
    judged, nees_us, values = None, np.empty(0, dtype=np.int64), np.empty(0)
    if truth is not None and len(t_us):
        judged = errors_against(t_us, rows[:, LLA], rows[:, V_L], rows[:, EULER], truth.columns())
        parts = [_nees(*second, truth) for second in seconds]
        nees_us, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        inside = (nees_us >= bounds_us[0]) & (nees_us <= bounds_us[1])
        nees_us, values = nees_us[inside], values[inside]
    nis: dict[str, tuple[float, int]] = {}
    refused: dict[tuple[str, str], int] = {}
    for name, statistics in estimator.statistics.items():
        statistics.fold()
        nis[name] = (statistics.nis_sum, statistics.rows)
        refused |= {(name, reason): n for reason, n in statistics.rejected.items()}
    return Run(
        filter_name,
        t_us,
        rows,
        judged,
        nees_us,
        values,
        nis,
        cpu_s,
        estimator.imu_rows,
        estimator.reset_counter,
        estimator.health.name.lower(),
        estimator.reason,
        tape.fixes(),
        refused,
    )


def _nees(
    frame: TangentFrame, t_us: IntArray, x: FloatArray, P: FloatArray, truth: Truth
) -> tuple[IntArray, FloatArray]:
    """The NEES at those instants that have a truth."""
    lla, v_l, q_lb, inside = interpolate_truth(t_us, *truth.columns())
    known = np.isfinite(np.column_stack([lla, v_l, q_lb])).all(axis=1)
    at = np.flatnonzero(np.logical_and(inside, known))
    x_true = x[at].copy()
    for row, k in zip(x_true, at.tolist(), strict=True):
        C_ln = frame.local_level(lla[k, 0], lla[k, 1])
        row[0:3] = frame.from_lla(lla[k, 0], lla[k, 1], lla[k, 2])
        row[3:6] = C_ln.T @ v_l[k]
        row[6:10] = quat_mul(quat_conj(dcm_to_quat(C_ln)), q_lb[k])
    return t_us[at], nees(errors(x_true, x[at]), P[at])


def converged_after(judged: Errors) -> float:
    """Seconds from the first judged estimate until the errors stay small; nan if they never do."""
    if not len(judged.t_us):
        return math.nan
    small = (np.hypot(judged.pos[:, 0], judged.pos[:, 1]) < CONVERGED_POS) & (
        np.abs(judged.att).max(axis=1) < CONVERGED_ATT
    )
    bad = np.flatnonzero(~small)
    starts, ends = np.append(0, bad + 1), np.append(bad, len(small)) - 1
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if end > start and judged.t_us[end] - judged.t_us[start] >= CONVERGED_FOR_US:
            return float(judged.t_us[start] - judged.t_us[0]) * 1e-6
    return math.nan


def together(runs: Sequence[Run]) -> dict[str, Any]:
    """What the runs of one filter say together: errors over all instants, NEES as the mean over the runs.

    pos in m and vel in m/s north, east, down; att is roll, pitch, yaw in deg; cpu_us is the estimator's whole CPU time
    per IMU sample. nees is the mean, nees_inside the share of seconds at which the mean over the runs keeps its 95 %
    band.
    """
    result: dict[str, Any] = {
        "cpu_us": 1e6 * sum(r.cpu_s for r in runs) / max(1, sum(r.imu_samples for r in runs)),
        "rows": sum(len(r.t_us) for r in runs),
        "resets": sum(r.resets for r in runs),
        "health": [r.health for r in runs],
        "nis": {},
    }
    for name in sorted({name for r in runs for name in r.nis}):
        sums = [r.nis[name] for r in runs if name in r.nis]
        rows = sum(n for _, n in sums)
        result["nis"][name] = sum(s for s, _ in sums) / rows if rows else None
    judged = [r.errors for r in runs if r.errors is not None and len(r.errors.t_us)]
    if judged:
        columns = {
            "pos": np.concatenate([e.pos for e in judged]),
            "vel": np.concatenate([e.vel for e in judged]),
            "att": np.degrees(np.concatenate([e.att for e in judged])),
        }
        known = {k: v[~np.isnan(v).any(axis=1)] for k, v in columns.items()}
        seen = {k: v for k, v in known.items() if len(v)}
        result["rms"] = {k: np.sqrt(np.mean(v**2, axis=0)).tolist() for k, v in seen.items()}
        result["max"] = {k: np.max(np.abs(v), axis=0).tolist() for k, v in seen.items()}
        result["convergence_s"] = float(np.median([converged_after(e) for e in judged]))
        result |= consistency([(r.nees_us, r.nees) for r in runs])
    return result


def consistency(runs: Sequence[tuple[IntArray, FloatArray]]) -> dict[str, Any]:
    """What the mean over the runs' NEES (instants and values of each) says, once they have settled."""
    seconds, mean = mean_nees(runs)
    if not len(seconds):
        return {}
    return {
        "nees": float(mean.mean()),
        "nees_band": list(band(DOF, len(runs))),
        "nees_inside": share_inside(mean, DOF, len(runs)),
    }


def mean_nees(runs: Sequence[tuple[IntArray, FloatArray]]) -> tuple[IntArray, FloatArray]:
    """The mean over runs at the seconds (M,) that all of them have, from SETTLED_US after each one's start on."""
    settled = [
        (t_us[late] // SECOND_US, values[late])
        for t_us, values in runs
        if len(t_us)
        for late in [t_us >= t_us[0] + SETTLED_US]
    ]
    if not settled or len(settled) < len(runs):
        return np.empty(0, dtype=np.int64), np.empty(0)
    seconds = settled[0][0]
    for other, _ in settled[1:]:
        seconds = np.intersect1d(seconds, other)
    picked = [values[np.searchsorted(at, seconds)] for at, values in settled]
    return seconds, np.mean(picked, axis=0)
