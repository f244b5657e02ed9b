"""Fusing one measurement into a filter state: gate, count, and the reset when the gate has been shut too long.

What must survive a rewind (when something was last accepted, how often the state was reset) lies in `Track`,
which is saved and restored with the filter state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading, magnetometer
from mavins.estimator.gate import gate_threshold
from mavins.filters.base import Filter, FilterState, sigmas_of
from mavins.types import FloatArray

RESETTABLE: Final = {gnss_position.NAME: (0, 0), gnss_velocity.NAME: (1, 3)}
"""aiding -> (place in Track, first state) of what can be reset to GNSS."""


_NOTHING: Final = np.empty(0)
_NO_ROWS: Final = np.empty((0, 0))


class Track(NamedTuple):
    """What the fusion remembers, times in us (-1: never).

    When position, velocity and heading (or a magnetic field) were last accepted, since when position and velocity
    have been rejected without a break and when they last were, how many resets there were, and when the last of them.
    """

    accepted_us: tuple[int, ...] = (-1, -1, -1)
    rejected_since_us: tuple[int, ...] = (-1, -1)
    rejected_us: tuple[int, ...] = (-1, -1)
    resets: int = 0
    reset_times_us: tuple[int, ...] = ()


@dataclass(slots=True)
class Event:
    """A measurement on the time line and what has become of it; `order` sorts events of one instant.

    `innovation` (m,) and its covariance `S` (m, m) are those before the update.
    """

    measurement: Measurement
    order: tuple[int, int, str, int]
    reason: str = ""
    nis: float = math.nan
    innovation: FloatArray = field(default_factory=lambda: _NOTHING)
    S: FloatArray = field(default_factory=lambda: _NO_ROWS)

    @property
    def accepted(self) -> bool:
        """True where it was fused."""
        return not self.reason

    def take(self, nis: float, innovation: FloatArray, S: FloatArray) -> None:
        """What the filter said of it."""
        self.nis, self.innovation, self.S = nis, innovation, S

    @property
    def sigma(self) -> FloatArray:
        """sqrt(diag S) (m,): how large the innovation was expected to be."""
        return sigmas_of(self.S)


def threshold_of(event: Event) -> float:
    """The NIS up to which an event is fused; negative for one that is not to be."""
    m = event.measurement
    return -1.0 if m.quality else gate_threshold(m.gate, len(m.z))


def _put(values: tuple[int, ...], place: int, value: int) -> tuple[int, ...]:
    return (*values[:place], value, *values[place + 1 :])


class Fusion:
    """Takes events to a filter and keeps the track."""

    def __init__(self, algorithm: Filter, reset_after: float) -> None:
        self.filter = algorithm
        self._reset_after = reset_after
        self._reset_after_us = round(reset_after * 1e6)
        self.track = Track()

    def anew(self) -> Fusion:
        """The same rules and filter without a track: to go through the same events once more."""
        return Fusion(self.filter, self._reset_after)

    def fuse(self, state: FilterState, event: Event) -> None:
        """Fuse one event at the state's time, which is the measurement's valid time; the event takes the outcome."""
        event.take(*self.filter.update(state, event.measurement, threshold_of(event)))
        self.conclude(state, event)

    def conclude(self, state: FilterState, event: Event) -> None:
        """What follows from the outcome of an event, of which `state` must be the state where it was refused."""
        m = event.measurement
        event.reason = m.quality
        if m.quality:
            return
        if event.nis <= threshold_of(event):
            self._accept(m)
        else:
            event.reason = "numeric" if math.isnan(event.nis) else "gate"
            self._reject(state, m, event)

    def _accept(self, m: Measurement) -> None:
        track = self.track
        # a magnetometer is as good as a heading
        place = heading.RANK if m.rank == magnetometer.RANK else m.rank
        if place < len(track.accepted_us):
            since = track.rejected_since_us
            if place < len(since) and since[place] >= 0:
                since = _put(since, place, -1)
            self.track = Track(
                _put(track.accepted_us, place, m.t_us),
                since,
                track.rejected_us,
                track.resets,
                track.reset_times_us,
            )

    def _reject(self, state: FilterState, m: Measurement, event: Event) -> None:
        if m.aiding not in RESETTABLE:
            return
        place, first = RESETTABLE[m.aiding]
        track = self.track
        since = track.rejected_since_us[place]
        # after a silence the count starts anew: what was rejected before it says nothing of what comes now
        if since < 0 or m.t_us - track.rejected_us[place] > self._reset_after_us:
            since = m.t_us
        self.track = track._replace(
            rejected_since_us=_put(track.rejected_since_us, place, since),
            rejected_us=_put(track.rejected_us, place, m.t_us),
        )
        if m.t_us - since < self._reset_after_us:
            return
        _reset_block(state, first, *m.linearize(state.x, state.u), m.R)
        self.filter.adopt(state)
        event.reason = "reset"
        self._accept(m)
        self.track = self.track._replace(
            resets=self.track.resets + 1,
            reset_times_us=(*self.track.reset_times_us[-7:], m.t_us),
        )


def _reset_block(
    state: FilterState, first: int, r: FloatArray, H: FloatArray, R: FloatArray
) -> None:
    """Shift position or velocity by its residual, and forget what was known of it and its correlations.

    The rows of H's block are orthonormal, so its transpose takes the residual back to n; a horizontal velocity
    leaves the vertical one alone.
    """
    axes = H[:, first : first + 3]
    state.x[first : first + 3] += axes.T @ r
    block = slice(first, first + len(r))
    state.P[block, :] = 0.0
    state.P[:, block] = 0.0
    state.P[block, block] = R
