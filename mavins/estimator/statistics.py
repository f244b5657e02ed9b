"""What the innovations say about the noises that were assumed, per aiding."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from mavins.estimator.fusion import Event


@dataclass(slots=True)
class AidingStatistics:
    """Counts of one aiding, and sums over its accepted measurements."""

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    nis_sum: float = 0.0
    rows: int = 0
    square_sum: list[float] = field(default_factory=lambda: [0.0] * 3)
    variance_sum: list[float] = field(default_factory=lambda: [0.0] * 3)
    noise_sum: list[float] = field(default_factory=lambda: [0.0] * 3)
    last_ratio: float = math.nan

    def add(self, event: Event, gate: float) -> None:
        """Count one final decision; `gate` is the NIS bound it was held against."""
        self.last_ratio = math.sqrt(event.nis / gate) if event.nis >= 0.0 else math.nan
        if not event.accepted:
            self.rejected[event.reason] += 1
            return
        self.accepted += 1
        self.nis_sum += event.nis
        self.rows += len(event.innovation)
        R = event.measurement.R
        for i, (r, sigma) in enumerate(
            zip(event.innovation.tolist(), event.sigma.tolist(), strict=True)
        ):
            self.square_sum[i] += r * r
            self.variance_sum[i] += sigma * sigma
            self.noise_sum[i] += float(R[i, i])

    def summary(self) -> dict[str, Any]:
        """Counts, the mean NIS per row (1 where the noises are right), and per component the innovation's RMS, the
        sigma it was expected to have and the sigma assumed for the measurement alone, in SI units."""
        result: dict[str, Any] = {"accepted": self.accepted, "rejected": dict(self.rejected)}
        if self.accepted:
            result["nis_per_row"] = self.nis_sum / self.rows
            used = [i for i, v in enumerate(self.variance_sum) if v > 0.0]
            for name, sums in (
                ("innovation_rms", self.square_sum),
                ("expected_rms", self.variance_sum),
                ("assumed_noise", self.noise_sum),
            ):
                result[name] = [math.sqrt(sums[i] / self.accepted) for i in used]
        return result
