"""The time line of one run of a filter: IMU rows, measurements and states to come back to.

A measurement belongs to its valid time. If that is past, the filter is taken back to a snapshot before it and
everything since is run again, gates included; if it lies ahead of the newest IMU sample, it waits. Where snapshots
happen to lie makes no difference to the result: a run is the same from any of them. Theory: docs/theory/time.md.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections.abc import Callable, Iterable, Sequence
from typing import TypeAlias

import numpy as np

from mavins.aiding import Measurement
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.fusion import Event, Fusion, Track
from mavins.estimator.history import History, Snapshot
from mavins.estimator.passage import Rows, Visit, passage_of
from mavins.filters import Filter, FilterState, RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_G, Layout
from mavins.nav.so3 import dcm_to_quat, quat_to_dcm
from mavins.types import FloatArray, IntArray

Arrivals: TypeAlias = Sequence[tuple[int, Measurement]]
"""Measurements, and after how many rows each came."""
LONGEST_RUN = 128
"""IMU rows that are walked at most in one go."""
ROWS_HELD = 512
"""Output rows are handed over in blocks; `flush` hands over what there is."""


def _time_of(item: Snapshot) -> int:
    return item.t_us


def _event_time(event: Event) -> int:
    return event.order[0]


def _event_order(event: Event) -> tuple[int, int, str, int]:
    return event.order


class Timeline:
    """IMU rows always; a state, and measurements on their way into it, from `begin` on."""

    def __init__(
        self,
        algorithm: Filter,
        fusion: Fusion,
        buffer_us: int,
        grid_us: int,
        rows: Callable[[RowBlock, TangentFrame], None] | None,
        history: History | None = None,
    ) -> None:
        self.buffer = ImuBuffer()
        self.state: FilterState | None = None
        self.frame: TangentFrame | None = None
        self.fusion = fusion
        self._filter = algorithm
        self._passage = passage_of(algorithm)
        self._buffer_us = buffer_us
        self._grid_us = grid_us
        self._write = rows
        self._history = history
        self._rows = RowBlock.empty(ROWS_HELD, algorithm.layout.size)
        self._events: list[Event] = []
        self._told = 0
        self._snapshots: list[Snapshot] = []
        self._sequence = 0

    def begin(self, state: FilterState, frame: TangentFrame, track: Track) -> None:
        """Start from a state between the buffered IMU rows, adopted by the filter, and walk to the newest.

        No row of this is written.
        """
        self.state, self.frame = state, frame
        self.fusion.track = track
        self._snapshots = [Snapshot(state.t_us, state.copy(), track)]
        self._tell_start(frame)
        self._run(self.buffer.row_after(state.t_us), -1, 0)

    def change_frame(self, frame: TangentFrame) -> list[Event]:
        """Go on in another frame; ends all decisions."""
        # what was estimated so far is written in the frame it was estimated in
        self.flush()
        decided = self.end()
        old, self.frame = self.frame, frame
        if self.state is not None and old is not None and old is not frame:
            _carry_over(self.state, self._filter.layout, old, frame)
        self._start_here()
        return decided

    def change_filter(self, fusion: Fusion) -> list[Event]:
        """Go on from the state as it is with another fusion and its filter, of the same layout; ends all decisions."""
        self.flush()
        decided = self.end()
        fusion.track = self.fusion.track
        self.fusion, self._filter = fusion, fusion.filter
        self._passage = passage_of(fusion.filter)
        if self.state is not None:
            self.state.own = np.empty((0, 0))
        self._start_here()
        return decided

    def _start_here(self) -> None:
        """From now on there is no way back behind the state as it is."""
        if self.state is None or self.frame is None:
            return
        self._filter.adopt(self.state)
        self._snapshots = [Snapshot(self.state.t_us, self.state.copy(), self.fusion.track)]
        self._tell_start(self.frame)

    def append(self, t_us: IntArray, imu: FloatArray, arrivals: Arrivals = ()) -> list[Event]:
        """Add IMU rows that follow the newest, with the measurements that came between them, and move the state on.

        `arrivals` says after how many of the rows each came, in their order; it is ignored without a state. Returns
        the measurements, decided, for which there is no place.
        """
        refused: list[Event] = []
        start, run = 0, list[Event]()
        for rows, m in arrivals if self.state is not None else ():
            newest_us = int(t_us[rows - 1]) if rows else self.buffer.newest_us
            event = self._event(m)
            if self._is_next(event, newest_us, run or self._events):
                run.append(event)
                continue
            self._advance(t_us[start:rows], imu[start:rows], run)
            start, run = rows, []
            refused += self.take((m,))
        self._advance(t_us[start:], imu[start:], run)
        return refused

    def _is_next(self, event: Event, newest_us: int, others: Sequence[Event]) -> bool:
        """True where an event that comes when `newest_us` is the newest stamp has its place there, after the others."""
        t_us = event.order[0]
        in_order = newest_us <= t_us <= newest_us + self._buffer_us
        return (
            in_order
            and t_us > self._snapshots[0].t_us
            and not (others and others[-1].order > event.order)
        )

    def _advance(self, t_us: IntArray, imu: FloatArray, events: Sequence[Event]) -> None:
        """Add rows, and events whose places are among or behind them, and move the state on."""
        self.buffer.append(t_us, imu)
        if self.state is None:
            return
        self._tell_rows(t_us, imu)
        i = self._unfused()
        self._events += events
        self._run(self.buffer.end - len(t_us), self._grid_us, i)

    def _event(self, m: Measurement) -> Event:
        self._sequence += 1
        return Event(m, (m.t_us, m.rank, m.source, self._sequence))

    def insert(self, t_us: int, reading: FloatArray) -> str:
        """Put a late IMU row in its place; returns why not, or nothing."""
        buffer = self.buffer
        if buffer.contains(t_us):
            return "IMU repeated"
        if t_us < max(buffer.oldest_us, buffer.newest_us - self._buffer_us):
            return "IMU too old"
        row = buffer.insert(t_us, reading)
        if self.state is not None:
            self._tell_rows(buffer.times(row, row + 1), buffer.readings(row, row + 1))
            # from the row before: between it and this one, readings lay on another line
            before = buffer.stamp(row - 1) if row > buffer.first else t_us
            self._rewind(before + 1)
        return ""

    def take(self, measurements: Iterable[Measurement]) -> list[Event]:
        """Fuse measurements where they belong; returns those, decided, for which there is no such place."""
        refused: list[Event] = []
        if self.state is None:
            return refused
        newest, earliest = self.buffer.newest_us, None
        oldest = max(self._snapshots[0].t_us, newest - self._buffer_us)
        for m in measurements:
            event = self._event(m)
            if m.t_us <= oldest:
                event.reason = "too old"
                refused.append(event)
            elif m.t_us > newest + self._buffer_us:
                event.reason = "too far ahead"
                refused.append(event)
            elif m.t_us == newest and earliest is None and not self._comes_before(event):
                self._events.append(event)
                self._run(self.buffer.end, -1, len(self._events) - 1)
            else:
                self._insert(event)
                if m.t_us <= newest:
                    earliest = m.t_us if earliest is None else min(earliest, m.t_us)
        if earliest is not None:
            self._rewind(earliest)
        return refused

    def _comes_before(self, event: Event) -> bool:
        """True where an event that is there already has its place behind this one."""
        return bool(self._events) and self._events[-1].order > event.order

    def _insert(self, event: Event) -> None:
        if self._comes_before(event):
            insort(self._events, event, key=_event_order)
        else:
            self._events.append(event)

    def prune(self, now_us: int, window_us: int) -> list[Event]:
        """Forget what no rewind can reach, but keep IMU rows over a window; returns the decisions now final."""
        horizon = now_us - self._buffer_us
        i = bisect_right(self._snapshots, horizon, key=_time_of) - 1
        if i > 0:
            del self._snapshots[:i]
        reachable = min(horizon, self._snapshots[0].t_us) if self._snapshots else horizon
        self.buffer.drop_before(reachable - window_us)
        # what is told must not depend on where snapshots lie; what a rewind may pass again is kept all the same
        told = bisect_right(self._events, horizon - 1, key=_event_time)
        decided = self._events[self._told : told]
        passed = bisect_right(self._events, reachable - 1, key=_event_time)
        if self._history is not None and self._snapshots:
            self._history.final(self._snapshots[0], self._events[:passed])
        del self._events[:passed]
        self._told = told - passed
        return decided

    def end(self) -> list[Event]:
        """All decisions that are still open; measurements that wait for IMU samples are given up."""
        fused = [event for event in self._events if len(event.innovation)]
        decided = [event for event in self._events[self._told :] if len(event.innovation)]
        self._events.clear()
        self._told = 0
        if self._history is not None and self.state is not None:
            self._history.decided(fused)
        return decided

    def flush(self) -> None:
        """Hand over the output rows that are held."""
        if self._rows.count and self._write is not None and self.frame is not None:
            self._write(self._rows, self.frame)
        if self._rows.count and self._history is not None:
            self._history.wrote(self._rows.t_us[: self._rows.count])
        self._rows.count = 0

    def _tell_start(self, frame: TangentFrame) -> None:
        if self._history is not None:
            start, buffer = self._snapshots[0], self.buffer
            first, end = buffer.row_after(start.t_us), buffer.end
            t_us, imu = buffer.times(first, end), buffer.readings(first, end)
            self._history.begin(start, frame, self.fusion, t_us, imu)

    def _tell_rows(self, t_us: IntArray, imu: FloatArray) -> None:
        if self._history is not None:
            self._history.rows(t_us, imu)

    def _rewind(self, t_us: int) -> None:
        """Run again everything from just before t_us."""
        assert self.state is not None
        i = bisect_right(self._snapshots, t_us - 1, key=_time_of) - 1
        if i < 0:
            return
        if self.state.t_us >= t_us:
            del self._snapshots[i + 1 :]
            self.state = self._snapshots[i].state.copy()
            self.fusion.track = self._snapshots[i].track
        self._run(self.buffer.row_after(self.state.t_us), -1, self._unfused())

    def _unfused(self) -> int:
        """The first event that is not fused yet: those that wait for IMU rows lie at the end."""
        assert self.state is not None
        i = len(self._events)
        while i > 0 and self._events[i - 1].order[0] > self.state.t_us:
            i -= 1
        return i

    def _run(self, first: int, grid_us: int, i: int) -> None:
        """Move the state to the newest row, fusing the events on the way: from row `first` and event `i` on."""
        state, frame, buffer = self.state, self.frame, self.buffer
        assert state is not None
        assert frame is not None
        while True:
            end = min(first + LONGEST_RUN, buffer.end)
            until_us = buffer.newest_us if end == buffer.end else buffer.stamp(end - 1)
            j = i
            while j < len(self._events) and self._events[j].order[0] <= until_us:
                j += 1
            if j == i and until_us <= state.t_us:
                return
            before_us = state.t_us if first == buffer.first else buffer.stamp(first - 1)
            t_us, imu = buffer.times(first, end), buffer.readings(first, end)
            rows = Rows(t_us, imu, before_us, until_us, grid_us, self._rows)
            events = self._events[i:j]
            done, visits = self._passage.go(state, frame, rows, events, self._snapshots[-1].t_us)
            self._conclude(state, events[:done], visits)
            i += done
            first = buffer.row_after(state.t_us)
            if self._rows.count > ROWS_HELD - LONGEST_RUN:
                self.flush()

    def _conclude(
        self, state: FilterState, events: Sequence[Event], visits: Iterable[Visit]
    ) -> None:
        """Draw the conclusions from events that were fused, and keep the states on the way with what was known then."""
        k = 0
        for visit in visits:
            for event in events[k : visit.events]:
                self.fusion.conclude(state, event)
            k = visit.events
            self._snapshots.append(Snapshot(visit.state.t_us, visit.state, self.fusion.track))
        for event in events[k:]:
            self.fusion.conclude(state, event)


def _carry_over(state: FilterState, layout: Layout, old: TangentFrame, new: TangentFrame) -> None:
    """Express a state of one tangent frame in another; of gravity's small turn, its part about level axes is kept."""
    C = new.C_ne @ old.C_ne.T
    lla = old.to_lla(state.x[:3])
    state.x[:3] = new.from_lla(*lla)
    state.x[3:6] = C @ state.x[3:6]
    state.x[6:10] = dcm_to_quat(C @ quat_to_dcm(state.x[6:10]))
    T = np.eye(state.P.shape[0])
    T[0:3, 0:3] = C
    T[3:6, 3:6] = C
    if layout.has_gravity:
        state.x[X_G] = C[:2, :2] @ state.x[X_G]
        T[-2:, -2:] = C[:2, :2]
    state.P[:, :] = T @ state.P @ T.T
