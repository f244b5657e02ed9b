"""A run of an estimator, smoothed: each stretch of its history is run again in the order of time, and then backwards.

The forward run decides: what it has accepted is fused again at the same instants from its own snapshots, so nothing
rewinds and the states are the same to the bit. Segments between two snapshots come last to first, which bounds the
memory. Nothing is passed over a reset, a re-alignment or a change of frame or filter. Theory: docs/theory/rts.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from mavins.estimator.fusion import Event
from mavins.estimator.history import History, Snapshot, Stretch
from mavins.filters import FilterState, RowBlock
from mavins.filters.rts import (
    MOVED,
    RESET,
    UPDATED,
    close_transition,
    smooth_back,
    walk_transitions,
)
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import CORE_SIZE, MOVING
from mavins.nav.layout import X_SIZE
from mavins.types import IntArray

ROWS_AT_ONCE = 256
"""IMU rows that are walked in one go: their covariances are all written down."""


def smooth(history: History) -> Iterator[tuple[RowBlock, TangentFrame]]:
    """The smoothed estimates at the stamps of the output rows, in blocks from the last to the first."""
    for stretch in reversed(history.stretches):
        for block in _Stretch(stretch).blocks():
            yield block, stretch.frame


class _Nodes:
    """The nodes of a segment as `rts.smooth_back` takes them, and the last IMU reading at each."""

    def __init__(self, capacity: int, size: int, moved_by: int) -> None:
        self.count = 0
        self.t_us = np.empty(capacity, dtype=np.int64)
        self.kind = np.full(capacity, MOVED, dtype=np.int64)
        self.written = np.zeros(capacity, dtype=np.int64)
        self.x = np.empty((capacity, X_SIZE))
        self.u = np.empty((capacity, 6))
        self.P = np.empty((capacity, size, size))
        self.Phi = np.empty((capacity, MOVING, moved_by))

    def put(self, state: FilterState, kind: int) -> None:
        """Add the state as it is."""
        k = self.count
        self.t_us[k], self.x[k], self.u[k], self.P[k] = state.t_us, state.x, state.u, state.P
        self.kind[k] = kind
        self.count += 1

    def put_rows(self, rows: RowBlock, due: IntArray) -> None:
        """Add those of the rows that are output."""
        k = np.flatnonzero(due[: rows.count])
        at = slice(self.count, self.count + len(k))
        self.t_us[at], self.x[at], self.u[at] = rows.t_us[k], rows.x[k], rows.u[k]
        self.P[at] = rows.P[k]
        self.written[at] = 1
        self.count += len(k)


class _Stretch:
    """A stretch on its way back."""

    def __init__(self, stretch: Stretch) -> None:
        self._filter = stretch.fusion.filter
        self._frame = stretch.frame
        self._snapshots = stretch.snapshots
        self._fusion = stretch.fusion.anew()
        self._t_us, self._imu = stretch.rows()
        self._clipped = stretch.clipped
        written = np.concatenate([np.empty(0, dtype=np.int64), *stretch.written])
        self._due = np.isin(self._t_us, written).astype(np.int64)
        self._events = sorted(stretch.events, key=lambda event: event.order)
        layout = self._filter.layout
        self._rows = RowBlock.empty(ROWS_AT_ONCE, layout.size)
        self._M = np.eye(layout.size if layout.has_gravity else CORE_SIZE)

    def blocks(self) -> Iterator[RowBlock]:
        """Smoothed output rows, a segment a block, the last one first."""
        if not len(self._t_us):
            return
        n = self._filter.layout.size
        lam, Lam = np.zeros(n), np.zeros((n, n))
        ends = [*(snapshot.t_us for snapshot in self._snapshots[1:]), int(self._t_us[-1])]
        for start, end_us in zip(reversed(self._snapshots), reversed(ends), strict=True):
            nodes = self._forward(start, end_us)
            k = nodes.count
            smooth_back(
                nodes.kind[:k],
                nodes.written[:k],
                nodes.x[:k],
                nodes.P[:k],
                nodes.Phi[:k],
                lam,
                Lam,
                self._filter.layout.columns,
            )
            at = np.flatnonzero(nodes.written[:k])
            if len(at):
                yield RowBlock(nodes.t_us[at], nodes.x[at], nodes.u[at], nodes.P[at], len(at))

    def _forward(self, start: Snapshot, end_us: int) -> _Nodes:
        """The nodes from a snapshot to the state at end_us, after the events of that instant."""
        events = [e for e in self._events if start.t_us < e.order[0] <= end_us]
        first, last = np.searchsorted(self._t_us, (start.t_us, end_us), "right").tolist()
        capacity = 2 + 2 * len(events) + int(self._due[first:last].sum())
        nodes = _Nodes(capacity, self._filter.layout.size, len(self._M))
        state = start.state.copy()
        self._fusion.track = start.track
        nodes.put(state, MOVED)
        for t_us, group in groupby(events, key=lambda event: event.order[0]):
            self._move(state, t_us, nodes)
            self._fuse(state, list(group), nodes)
        self._move(state, end_us, nodes)
        return nodes

    def _fuse(self, state: FilterState, events: list[Event], nodes: _Nodes) -> None:
        """Fuse the events of an instant, as the forward run did."""
        again = [Event(event.measurement, event.order) for event in events]
        for event in again:
            self._fusion.fuse(state, event)
        if any(event.reason == "reset" for event in again):
            nodes.put(state, RESET)
        elif any(event.accepted for event in again):
            nodes.put(state, UPDATED)

    def _move(self, state: FilterState, until_us: int, nodes: _Nodes) -> None:
        """Walk to until_us, with a node there and at each output row on the way."""
        if until_us == state.t_us:
            return
        begin = int(self._t_us.searchsorted(state.t_us, "right"))
        while state.t_us < until_us:
            alike, clipped = self._clipped.run(self._t_us[begin : begin + ROWS_AT_ONCE])
            end = begin + alike
            self._walk(state, begin, end, min(until_us, int(self._t_us[end - 1])), clipped, nodes)
            begin = end
        if nodes.t_us[nodes.count - 1] != until_us:
            close_transition(self._M, nodes.Phi[nodes.count])
            nodes.put(state, MOVED)

    def _walk(
        self,
        state: FilterState,
        first: int,
        end: int,
        until_us: int,
        clipped: bool,
        nodes: _Nodes,
    ) -> None:
        """Walk rows first to end (exclusive) to until_us."""
        t_us, imu, due = self._t_us[first:end], self._imu[first:end], self._due[first:end]
        frame, rows = self._frame, self._rows
        walk_transitions(
            self._M,
            state.x.copy(),
            state.u.copy(),
            state.t_us,
            t_us,
            imu,
            due,
            until_us,
            frame.r0_e,
            frame.C_ne,
            frame.w_ie_n,
            nodes.Phi[nodes.count :],
        )
        rows.count = 0
        self._filter.walk(state, frame, t_us, imu, until_us, state.t_us, 0, rows, clipped)
        nodes.put_rows(rows, due)
