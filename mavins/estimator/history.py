"""What a run of a filter leaves for a smoother: all it takes to run it again, from any of its snapshots."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mavins.estimator.clipping import Clipped
from mavins.estimator.fusion import Event, Fusion, Track
from mavins.filters import FilterState
from mavins.nav.earth import TangentFrame
from mavins.types import FloatArray, IntArray

SEGMENT_US = 10_000_000
"""At least so far apart are two snapshots."""


class Snapshot(NamedTuple):
    """A state to come back to: all events up to and at its instant are in."""

    t_us: int
    state: FilterState
    track: Track


@dataclass(slots=True)
class Stretch:
    """A run of a filter in one frame, from a start to where it was lost, re-framed, replaced or ended.

    `fusion` is what put measurements to the filter. `t_us`, `imu` and `written` are pieces: stamps and readings of the
    IMU rows after the start, in the order in which they came, and the stamps of the output rows. `events` are those
    that were put to the filter, `clipped` the rows in which the accelerometer was at its limit.
    """

    frame: TangentFrame
    fusion: Fusion
    snapshots: list[Snapshot]
    t_us: list[IntArray]
    imu: list[FloatArray]
    events: list[Event] = field(default_factory=list)
    written: list[IntArray] = field(default_factory=list)
    clipped: Clipped = field(default_factory=Clipped)

    def rows(self) -> tuple[IntArray, FloatArray]:
        """Stamps (N,) and readings (N, 6) of the IMU rows in the order of time."""
        t_us, imu = np.concatenate(self.t_us), np.concatenate(self.imu)
        if np.all(t_us[1:] > t_us[:-1]):
            return t_us, imu
        order = np.argsort(t_us, kind="stable")
        return t_us[order], imu[order]


class History:
    """The stretches of an estimator's life, told by its time lines."""

    def __init__(self) -> None:
        self.stretches: list[Stretch] = []

    def begin(
        self,
        start: Snapshot,
        frame: TangentFrame,
        fusion: Fusion,
        t_us: IntArray,
        imu: FloatArray,
    ) -> None:
        """A run begins; the rows are those already there that follow its start."""
        self.stretches.append(Stretch(frame, fusion, [start], [t_us.copy()], [imu.copy()]))

    def rows(self, t_us: IntArray, imu: FloatArray) -> None:
        """IMU rows have come in."""
        self.stretches[-1].t_us.append(t_us.copy())
        self.stretches[-1].imu.append(imu.copy())

    def clipped(self, t_us: IntArray) -> None:
        """The accelerometer was at its limit in the rows with these stamps."""
        self.stretches[-1].clipped.mark(t_us)

    def final(self, oldest: Snapshot, events: Iterable[Event]) -> None:
        """No rewind goes back behind `oldest` any more, and these events are decided."""
        stretch = self.stretches[-1]
        if oldest.t_us - stretch.snapshots[-1].t_us >= SEGMENT_US:
            stretch.snapshots.append(oldest)
        self.decided(events)

    def decided(self, events: Iterable[Event]) -> None:
        """These events are decided."""
        # one without an innovation has never been put to the filter
        self.stretches[-1].events += [event for event in events if len(event.innovation)]

    def wrote(self, t_us: IntArray) -> None:
        """Output rows with these stamps are handed over."""
        self.stretches[-1].written.append(t_us.copy())
