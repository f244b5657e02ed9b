"""Through IMU rows and the measurements between them in one go: what `Timeline` moves its state with.

Any filter can be taken from one measurement to the next (`Stepwise`). For the error-state filter a kernel does the
whole stretch, with the same arithmetic and so to the same bits (`Compiled`): most of a measurement's time goes into
calling, not into calculating.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np

from mavins.aiding.many import linearize
from mavins.estimator.fusion import RESETTABLE, Event, threshold_of
from mavins.filters import Filter, FilterState, RowBlock
from mavins.filters.eskf import Eskf, fuse, step
from mavins.filters.walking import is_due, put_row, reading_at
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import workspace
from mavins.nav.kernels import kernel
from mavins.nav.layout import X_SIZE
from mavins.types import FloatArray, IntArray

SNAPSHOT_US: Final = 40_000
"""At least so far apart are two places to come back to."""
_PARAMETERS: Final = 20
"""The most parameters that an aiding has."""
_GATE: Final = 12
_FIRST: Final = 13
"""Places of the gate and the first parameter in a row of numbers: z and R lie before them."""
_U: Final = X_SIZE
_P: Final = X_SIZE + 6
"""Places of u and P in a row of visited states, x lies before them."""


@dataclass(frozen=True, slots=True)
class Rows:
    """The IMU rows of a stretch: stamps (N,), readings (N, 6), and the stamp of the row before the first.

    `until_us`, at or before the last stamp, is where the stretch ends; output rows for the grid go to `out`.
    `clipped`: the accelerometer was at its limit in all of them.
    """

    t_us: IntArray
    imu: FloatArray
    before_us: int
    until_us: int
    grid_us: int
    out: RowBlock
    clipped: bool = False


class Visit(NamedTuple):
    """A state on the way, with all events up to its instant in: the first `events` of those that were handed over."""

    events: int
    state: FilterState


class Passage(Protocol):
    """Moves a state on."""

    def go(
        self,
        state: FilterState,
        frame: TangentFrame,
        rows: Rows,
        events: Sequence[Event],
        last_us: int,
    ) -> tuple[int, list[Visit]]:
        """Move `state` through the rows and fuse the events, in their order and none later than the end, on the way.

        Each event takes its outcome. Returns how many were fused, for it may stop behind any (behind one that is
        refused and may reset the state it does), and states to come back to, the last of which before was at
        `last_us`.
        """


def passage_of(algorithm: Filter) -> Passage:
    """The quickest way for a filter."""
    return Compiled(algorithm) if type(algorithm) is Eskf else Stepwise(algorithm)


class Stepwise:
    """A call of the filter for each stretch between two measurements, and for each measurement."""

    def __init__(self, algorithm: Filter) -> None:
        self._filter = algorithm

    def go(
        self,
        state: FilterState,
        frame: TangentFrame,
        rows: Rows,
        events: Sequence[Event],
        last_us: int,
    ) -> tuple[int, list[Visit]]:
        """Move on to the first event, or where there is none to the end."""
        until_us = events[0].order[0] if events else rows.until_us
        visits = []
        if until_us > state.t_us:
            if state.t_us - last_us >= SNAPSHOT_US:
                visits.append(Visit(0, state.copy()))
            end = int(rows.t_us.searchsorted(until_us, "right")) + 1
            t_us, imu, out = rows.t_us[:end], rows.imu[:end], rows.out
            before_us, grid_us, clipped = rows.before_us, rows.grid_us, rows.clipped
            self._filter.walk(state, frame, t_us, imu, until_us, before_us, grid_us, out, clipped)
        if not events:
            return 0, visits
        event = events[0]
        event.take(*self._filter.update(state, event.measurement, threshold_of(event)))
        return 1, visits


class Compiled:
    """All in one kernel, for the error-state filter."""

    def __init__(self, algorithm: Eskf) -> None:
        self._filter = algorithm

    def go(
        self,
        state: FilterState,
        frame: TangentFrame,
        rows: Rows,
        events: Sequence[Event],
        last_us: int,
    ) -> tuple[int, list[Visit]]:
        """Move on to the end, or to the first event that must be looked at."""
        n, size = len(events), len(state.P)
        whats, numbers = _tables(events)
        most = max(0, rows.until_us - last_us) // SNAPSHOT_US + 1
        places = np.empty((most, 2), dtype=np.int64)
        visited, outcomes = np.empty((most, _P + size * size)), np.empty((n, 13))
        layout, out = self._filter.layout, rows.out
        state.t_us, done, visits, out.count = pass_rows(
            state.x,
            state.P,
            state.u,
            state.t_us,
            rows.t_us,
            rows.imu,
            self._filter.noises[rows.clipped],
            layout.columns,
            layout.has_gravity,
            frame.r0_e,
            frame.C_ne,
            frame.w_ie_n,
            rows.before_us,
            rows.until_us,
            rows.grid_us,
            out.t_us,
            out.x,
            out.u,
            out.P,
            out.count,
            whats,
            numbers,
            outcomes,
            last_us,
            places,
            visited,
        )
        for event, nis, row in zip(events, outcomes[:done, 0].tolist(), outcomes, strict=False):
            m = len(event.measurement.z)
            event.take(nis, row[1 : 1 + m], row[4 : 4 + m * m].reshape(m, m))
        return done, [
            Visit(count, FilterState(row[:_U], row[_P:].reshape(size, size), row[_U:_P], t_us))
            for (t_us, count), row in zip(places[:visits].tolist(), visited, strict=False)
        ]


_NO_TABLES: Final = (np.empty((0, 5), dtype=np.int64), np.empty((0, _FIRST + _PARAMETERS)))


def _tables(events: Sequence[Event]) -> tuple[IntArray, FloatArray]:
    """Events as the kernel takes them.

    (M, 5): valid time, rank, rows, parameters, 1 where a refusal must be looked at; (M, 33): z, R, gate, parameters.
    """
    if not events:
        return _NO_TABLES
    whats = np.empty((len(events), 5), dtype=np.int64)
    numbers = np.empty((len(events), _FIRST + _PARAMETERS))
    for k, event in enumerate(events):
        m = event.measurement
        rows, count = len(m.z), len(m.parameters)
        whats[k] = m.t_us, m.rank, rows, count, m.aiding in RESETTABLE
        row = numbers[k]
        row[:rows] = m.z
        row[3 : 3 + rows * rows] = m.R.ravel()
        row[_GATE] = threshold_of(event)
        row[_FIRST : _FIRST + count] = m.parameters
    return whats, numbers


@kernel
def _fuse_event(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    columns: IntArray,
    what: IntArray,
    numbers: FloatArray,
    outcome: FloatArray,
) -> bool:
    """Fuse one event of the tables; `outcome` (13,) <- NIS, innovation, S; False where it was refused."""
    m, gate = what[2], numbers[_GATE]
    R, S = np.empty((m, m)), np.empty((m, m))
    for i in range(m):
        for j in range(m):
            R[i, j] = numbers[3 + m * i + j]
    r, H = linearize(what[1], x, u, numbers[:m], numbers[_FIRST : _FIRST + what[3]])
    for i in range(m):
        outcome[1 + i] = r[i]
    outcome[0] = fuse(x, P, r, H, R, columns, gate, S)
    for i in range(m):
        for j in range(m):
            outcome[4 + m * i + j] = S[i, j]
    return bool(outcome[0] <= gate)


@kernel
def _keep(x: FloatArray, u: FloatArray, P: FloatArray, row: FloatArray) -> None:
    """Write a state into a row."""
    n = P.shape[0]
    for i in range(len(x)):
        row[i] = x[i]
    for i in range(6):
        row[_U + i] = u[i]
    for i in range(n):
        for j in range(n):
            row[_P + n * i + j] = P[i, j]


@kernel
def pass_rows(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    start_us: int,
    t_us: IntArray,
    imu: FloatArray,
    noise: FloatArray,
    columns: IntArray,
    has_gravity: bool,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    before_us: int,
    until_us: int,
    grid_us: int,
    out_t: IntArray,
    out_x: FloatArray,
    out_u: FloatArray,
    out_P: FloatArray,
    count: int,
    whats: IntArray,
    numbers: FloatArray,
    outcomes: FloatArray,
    last_us: int,
    places: IntArray,
    visited: FloatArray,
) -> tuple[int, int, int, int]:
    """`Passage.go`; returns where it ended, and how many events were fused, states kept and output rows filled."""
    work = workspace(P.shape[0], has_gravity)
    t, before, k, visits = start_us, before_us, 0, 0
    for e in range(len(whats) + 1):
        target = whats[e, 0] if e < len(whats) else until_us
        while t < target:
            # all events so far are in: a place to come back to
            if t - last_us >= SNAPSHOT_US:
                last_us = t
                places[visits, 0], places[visits, 1] = t, e
                _keep(x, u, P, visited[visits])
                visits += 1
            # one call of `step`, for each is compiled into this kernel
            to, reading = t_us[k], imu[k]
            if to > target:
                to, reading = target, reading_at(u, imu[k], (target - t) / (t_us[k] - t))
            step(x, P, u, reading, to - t, noise, r0_e, C_ne, w_ie_n, work)
            t = to
            if t < t_us[k]:
                break
            k += 1
            if is_due(t, before, grid_us):
                put_row(out_t, out_x, out_u, out_P, count, t, x, u, P)
                count += 1
            before = t
        if e == len(whats):
            break
        fused = _fuse_event(x, P, u, columns, whats[e], numbers[e], outcomes[e])
        if not fused and whats[e, 4] and numbers[e, _GATE] >= 0.0:
            return t, e + 1, visits, count
    return t, len(whats), visits, count
