"""What the innovations say about the noises that were assumed, per aiding."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavins.estimator.fusion import Event
from mavins.types import FloatArray, IntArray

_FOLD_AT = 1000


@dataclass(slots=True)
class AidingStatistics:
    """Counts of one aiding, and sums over its accepted measurements.

    Measurements are kept as they come and summed many at a time; `fold` brings the sums up to date.
    """

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    nis_sum: float = 0.0
    rows: int = 0
    last_ratio: float = math.nan
    _squares: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    _counts: IntArray = field(default_factory=lambda: np.zeros(3, dtype=np.int64))
    _pending: list[Event] = field(default_factory=list)

    def add(self, event: Event, gate: float) -> None:
        """Count one final decision; `gate` is the NIS bound it was held against."""
        self.last_ratio = math.sqrt(event.nis / gate) if event.nis >= 0.0 else math.nan
        if not event.accepted:
            self.rejected[event.reason] += 1
            return
        self.accepted += 1
        self.rows += len(event.innovation)
        self._pending.append(event)
        if len(self._pending) >= _FOLD_AT:
            self.fold()

    def fold(self) -> None:
        """Add what is pending to the sums."""
        self.nis_sum += math.fsum(event.nis for event in self._pending)
        for m in (1, 2, 3):
            events = [event for event in self._pending if len(event.innovation) == m]
            if events:
                innovation = np.array([event.innovation for event in events])
                S = np.array([event.S for event in events])
                R = np.array([event.measurement.R for event in events])
                expected, noise = (np.diagonal(C, axis1=1, axis2=2) for C in (S, R))
                self._squares[0, :m] += (innovation**2).sum(axis=0)
                self._squares[1, :m] += expected.sum(axis=0)
                self._squares[2, :m] += noise.sum(axis=0)
                self._counts[:m] += len(events)
        self._pending.clear()

    def summary(self) -> dict[str, Any]:
        """What the innovations show.

        Counts, the mean NIS per row (1 where the noises are right), and per component the innovation's RMS, the
        sigma it was expected to have and the sigma assumed for the measurement alone, in SI units.
        """
        self.fold()
        result: dict[str, Any] = {"accepted": self.accepted, "rejected": dict(self.rejected)}
        if self.accepted:
            result["nis_per_row"] = self.nis_sum / self.rows
            used = self._counts > 0
            roots = np.sqrt(self._squares[:, used] / self._counts[used])
            names = ("innovation_rms", "expected_rms", "assumed_noise")
            result |= {name: row.tolist() for name, row in zip(names, roots, strict=True)}
        return result
