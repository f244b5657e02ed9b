"""Stands between a source and an estimator, hands on everything, and keeps what a report needs of it.

What it costs must not show beside the estimator: tables are kept as they come and looked at many at a time.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Final

import numpy as np

from mavins.estimator.feed import Between, Feed, Relay
from mavins.estimator.vibration import CLIP
from mavins.evaluation.evidence import Evidence, Gnss, ImuSeconds
from mavins.evaluation.spectrum import Welch
from mavins.logs.truth import Truth
from mavins.types import (
    BaroSample,
    BoolArray,
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuTable,
    IntArray,
    MagSample,
)

_BLOCK: Final = 16_384
"""IMU rows that are looked at together."""
_SECOND_US: Final = 1_000_000
_BIN_US: Final = 100
_BINS: Final = 2_000


class Witness(Relay):
    """Stands in front of a `Feed` (estimator/feed.py)."""

    def __init__(self, feed: Feed) -> None:
        super().__init__(feed)
        self._tables: list[ImuTable] = []
        self._waiting = 0
        self._seconds = _Seconds()
        self._welch = Welch()
        self._fixes = array("d")
        self._headings = array("d")
        self._mag = array("q")
        self._baro = array("q")

    def feed_imu(self, table: ImuTable) -> None:
        """Hand on IMU samples, and keep them until they are enough to be looked at."""
        super().feed_imu(table)
        self._keep(table)

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        """Hand on IMU samples and readings together, and keep of them what is kept of each."""
        self.feed.feed_run(table, between)
        self._keep(table)
        for _, reading in between:
            match reading:
                case HeadingFix():
                    self._headings.extend((reading.t_us, reading.yaw))
                case MagSample():
                    self._mag.append(reading.t_us)
                case BaroSample():
                    self._baro.append(reading.t_us)

    def feed_gnss(self, fix: GnssFix) -> None:
        """Hand on and keep a GNSS fix."""
        super().feed_gnss(fix)
        v = fix.v_l or (np.nan, np.nan, np.nan)
        claims = (fix.satellites, fix.sigma_h, fix.sigma_v, fix.sigma_speed)
        known = (np.nan if claim is None else claim for claim in claims)
        self._fixes.extend((fix.t_us, fix.lat, fix.lon, fix.alt, *v, fix.fix_type, *known))

    def feed_heading(self, fix: HeadingFix) -> None:
        """Hand on and keep a heading."""
        super().feed_heading(fix)
        self._headings.extend((fix.t_us, fix.yaw))

    def feed_mag(self, sample: MagSample) -> None:
        """Hand on a magnetometer's reading, and keep its stamp."""
        super().feed_mag(sample)
        self._mag.append(sample.t_us)

    def feed_baro(self, sample: BaroSample) -> None:
        """Hand on a barometer's reading, and keep its stamp."""
        super().feed_baro(sample)
        self._baro.append(sample.t_us)

    def evidence(self, truth: Truth | None = None, reference: Truth | None = None) -> Evidence:
        """What it has seen until now, and what to judge by."""
        self._look()
        fixes = np.array(self._fixes, dtype=np.float64).reshape(-1, 12)
        headings = np.array(self._headings, dtype=np.float64).reshape(-1, 2)
        return Evidence(
            Gnss(
                fixes[:, 0].astype(np.int64),
                fixes[:, 1:4],
                fixes[:, 4:7],
                fixes[:, 7].astype(np.int64),
                fixes[:, 8],
                fixes[:, 9:12],
            ),
            self._seconds.table(),
            self._welch.spectrum(),
            headings[:, 0].astype(np.int64),
            headings[:, 1],
            np.array(self._mag, dtype=np.int64),
            np.array(self._baro, dtype=np.int64),
            truth,
            reference,
        )

    def _keep(self, table: ImuTable) -> None:
        self._tables.append(table)
        self._waiting += len(table)
        if self._waiting >= _BLOCK:
            self._look()

    def _look(self) -> None:
        if not self._tables:
            return
        t_us = np.concatenate([table.t_us for table in self._tables])
        gyro = np.concatenate([table.gyro_b for table in self._tables])
        accel = np.concatenate([table.accel_b for table in self._tables])
        rows = np.hstack([gyro, accel])
        clipped = np.concatenate([table.at_limit for table in self._tables])
        clipped |= (abs(accel) >= CLIP).any(axis=1)
        self._tables.clear()
        self._waiting = 0
        self._seconds.take(t_us, rows, clipped)
        self._welch.take(t_us, rows)


class _Seconds:
    """Sums over the samples of each second; a second that two blocks share has its sums added up."""

    def __init__(self) -> None:
        self._parts: list[tuple[IntArray, ...]] = []
        self._sums: list[FloatArray] = []
        self._intervals = np.zeros(_BINS + 1, dtype=np.int64)
        self._last: IntArray = np.empty(0, dtype=np.int64)

    def take(self, t_us: IntArray, rows: FloatArray, clipped: BoolArray) -> None:
        """Add consecutive rows (N, 6) of gyro and accelerometer, and where this was at its limit (N,)."""
        steps = np.diff(np.concatenate([self._last if len(self._last) else t_us[:1], t_us]))
        self._last = t_us[-1:]
        bins = np.clip(steps[steps > 0] // _BIN_US, 0, _BINS)
        self._intervals += np.bincount(bins, minlength=_BINS + 1)
        second = t_us // _SECOND_US
        first = np.flatnonzero(np.diff(second, prepend=second[0] - 1))
        count = np.diff(np.append(first, len(t_us)))
        self._parts.append(
            (
                second[first],
                count,
                np.maximum.reduceat(np.maximum(steps, 0), first),
                np.add.reduceat(clipped.astype(np.int64), first),
            )
        )
        mean = np.add.reduceat(rows, first) / count[:, None]
        squares = np.add.reduceat((rows - np.repeat(mean, count, axis=0)) ** 2, first)
        self._sums.append(np.hstack([mean, squares]))

    def table(self) -> ImuSeconds:
        """All seconds so far, in the order in which they came."""
        if not self._parts:
            none = np.empty(0, dtype=np.int64)
            return ImuSeconds(none, none, none, np.empty((0, 6)), none, self._intervals)
        second, count, longest, clipped = (
            np.concatenate(parts) for parts in zip(*self._parts, strict=True)
        )
        sums = np.concatenate(self._sums)
        first = np.flatnonzero(np.diff(second, prepend=second[0] - 1))
        total = np.add.reduceat(count, first)
        weight = count[:, None]
        mean = np.add.reduceat(weight * sums[:, :6], first) / total[:, None]
        # within the parts, and between them
        apart = sums[:, :6] - np.repeat(mean, np.diff(np.append(first, len(second))), axis=0)
        squares = np.add.reduceat(sums[:, 6:] + weight * apart**2, first)
        return ImuSeconds(
            second[first] * _SECOND_US,
            total,
            np.maximum.reduceat(longest, first),
            np.sqrt(squares / total[:, None]),
            np.add.reduceat(clipped, first),
            self._intervals,
        )
