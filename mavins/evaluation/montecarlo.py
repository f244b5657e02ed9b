"""One run of a Monte-Carlo series: measurements through the estimator, ordered by stamp.

The measurements may come from a simulator or a log: this module knows neither, only `types`.
Theory: docs/theory/consistency.md.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.fusion import Event
from mavins.estimator.settings import Settings
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_SIZE
from mavins.types import FloatArray, GnssFix, HeadingFix, ImuTable, IntArray, Origin


@dataclass(frozen=True, slots=True)
class Estimates:
    """Estimates at instants `t_us` (N,): states `x` (N, 26) and covariances `P` (N, 15, 15).

    `decisions` counts the measurements by (aiding, reason), the reason empty where one was fused.
    """

    t_us: IntArray
    x: FloatArray
    P: FloatArray
    decisions: Counter[tuple[str, str]]


def estimate(
    settings: Settings,
    origin: Origin,
    imu: ImuTable,
    fixes: Sequence[GnssFix],
    headings: Sequence[HeadingFix],
    grid_us: int,
    filter_name: str = "eskf",
) -> Estimates:
    """Run the estimator over measurements by stamp; a row at each multiple of `grid_us`.

    At one stamp the IMU comes first, then headings, then fixes. Frame n is put at `origin`.
    """
    blocks: list[tuple[IntArray, FloatArray, FloatArray]] = []
    decisions: Counter[tuple[str, str]] = Counter()

    def take(block: RowBlock, _: TangentFrame) -> None:
        n = block.count
        blocks.append((block.t_us[:n].copy(), block.x[:n].copy(), block.P[:n].copy()))

    def decide(event: Event) -> None:
        decisions[event.measurement.aiding, event.reason] += 1

    estimator = Estimator(settings, filter_name, Outputs(grid_us, take, decide))
    estimator.set_origin(origin)
    start = 0
    aids: Iterator[GnssFix | HeadingFix] = heapq.merge(headings, fixes, key=_stamp)
    for aid in aids:
        end = int(imu.t_us.searchsorted(aid.t_us, "right"))
        if end > start:
            estimator.feed_imu(_rows(imu, start, end))
            start = end
        if isinstance(aid, HeadingFix):
            estimator.feed_heading(aid)
        else:
            estimator.feed_gnss(aid)
    if start < len(imu):
        estimator.feed_imu(_rows(imu, start, len(imu)))
    estimator.finish()
    if not blocks:
        return Estimates(
            np.empty(0, dtype=np.int64), np.empty((0, X_SIZE)), np.empty((0, 15, 15)), decisions
        )
    t_us, x, P = (np.concatenate(part) for part in zip(*blocks, strict=True))
    return Estimates(t_us, x, P, decisions)


def _stamp(aid: GnssFix | HeadingFix) -> int:
    return aid.t_us


def _rows(imu: ImuTable, start: int, end: int) -> ImuTable:
    return ImuTable(imu.t_us[start:end], imu.accel_b[start:end], imu.gyro_b[start:end])
