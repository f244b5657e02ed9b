"""What the innovations say about the noises that were assumed, per aiding."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavins.estimator.fusion import Event
from mavins.types import FloatArray


@dataclass(slots=True)
class AidingStatistics:
    """Counts of one aiding, and sums over its accepted measurements."""

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    nis_sum: float = 0.0
    rows: int = 0
    square_sum: FloatArray = field(default_factory=lambda: np.zeros(3))
    variance_sum: FloatArray = field(default_factory=lambda: np.zeros(3))
    noise_sum: FloatArray = field(default_factory=lambda: np.zeros(3))
    last_ratio: float = math.nan

    def add(self, event: Event, gate: float) -> None:
        """Count one final decision; `gate` is the NIS bound it was held against."""
        self.last_ratio = math.sqrt(event.nis / gate) if event.nis >= 0.0 else math.nan
        if not event.accepted:
            self.rejected[event.reason] += 1
            return
        n = len(event.innovation)
        self.accepted += 1
        self.nis_sum += event.nis
        self.rows += n
        self.square_sum[:n] += event.innovation**2
        self.variance_sum[:n] += event.sigma**2
        self.noise_sum[:n] += np.diag(event.measurement.R)

    def summary(self) -> dict[str, Any]:
        """Counts, the mean NIS per row (1 where the noises are right), and per component the innovation's RMS, the
        sigma it was expected to have and the sigma assumed for the measurement alone, in SI units."""
        result: dict[str, Any] = {"accepted": self.accepted, "rejected": dict(self.rejected)}
        if self.accepted:
            used = self.variance_sum > 0.0
            result["nis_per_row"] = self.nis_sum / self.rows
            result["innovation_rms"] = np.sqrt(self.square_sum[used] / self.accepted).tolist()
            result["expected_rms"] = np.sqrt(self.variance_sum[used] / self.accepted).tolist()
            result["assumed_noise"] = np.sqrt(self.noise_sum[used] / self.accepted).tolist()
        return result
