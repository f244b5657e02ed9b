"""How likely the measurements of a flight are to a filter: what it expected of each, and what came.

    log p = -1/2 sum (rho(NIS) + log det S + m log 2 pi),   rho(n) = n up to c^2, c^2 (1 + log(n / c^2)) above

rho gives the density tails of |r|^(-c^2): an outlier weighs no more than one at the bend, but is never for free, since
with c^2 > m a smaller S costs more there than its determinant gives. Every measurement counts, fused or refused; a run
that has no innovation for one of them has no likelihood. Pseudo-measurements (a standing vehicle's zero velocity) are
no data.

Source: Schweppe (1965); Huber (1981), chapter 5, for rho. Theory: docs/theory/tuning.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.aiding import baro, gnss_position, gnss_velocity, heading, magnetometer
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.fusion import Event
from mavins.estimator.gate import gate_threshold
from mavins.estimator.settings import Settings
from mavins.evaluation.tape import Tape
from mavins.types import FloatArray, IntArray

MEASURED: Final = (
    gnss_position.NAME,
    gnss_velocity.NAME,
    heading.NAME,
    magnetometer.NAME,
    baro.NAME,
)
"""Aidings that are sensors."""
ROBUST_SIGMAS: Final = 3.0
"""From here on rho bends, in sigmas of one row."""


@dataclass(frozen=True, slots=True)
class Innovations:
    """Those of one aiding with m rows, by stamp: `stamps` (N,) in us, `r` (N, m), their covariances `S` (N, m, m)."""

    stamps: IntArray
    r: FloatArray
    S: FloatArray

    def between(self, start_us: int, end_us: int) -> Innovations:
        """Those with start_us <= stamp < end_us."""
        k = slice(*np.searchsorted(self.stamps, (start_us, end_us)).tolist())
        return Innovations(self.stamps[k], self.r[k], self.S[k])

    def bend(self) -> float:
        """c^2, the NIS from which on rho bends."""
        return gate_threshold(ROBUST_SIGMAS, self.r.shape[1])

    def log_likelihoods(self) -> FloatArray:
        """The term (N,) of each; -inf where S is no covariance."""
        n, m = self.r.shape
        if not n:
            return np.empty(0)
        sign, log_det = np.linalg.slogdet(self.S)
        good = (sign > 0.0) & np.isfinite(log_det)
        nis = np.full(n, math.inf)
        solved = np.linalg.solve(self.S[good], self.r[good][..., None])[..., 0]
        nis[good] = np.einsum("ni,ni->n", self.r[good], solved)
        bend = self.bend()
        rho = np.where(nis <= bend, nis, bend * (1.0 + np.log(np.maximum(nis, bend) / bend)))
        return np.where(good, -0.5 * (rho + log_det + m * math.log(2.0 * math.pi)), -math.inf)


Flight = dict[tuple[str, int], Innovations]
"""(aiding, rows of a measurement) -> its innovations."""


def innovations(settings: Settings, filter_name: str, tape: Tape) -> Flight:
    """All innovations of one run at their final decision."""
    found: dict[tuple[str, int], list[Event]] = {}

    def decide(event: Event) -> None:
        m = event.measurement
        if m.aiding in MEASURED and not m.quality and len(event.innovation):
            found.setdefault((m.aiding, len(m.z)), []).append(event)

    tape.play(Estimator(settings, filter_name, Outputs(decision=decide)))
    return {key: _table(events) for key, events in sorted(found.items())}


def _table(events: list[Event]) -> Innovations:
    events.sort(key=lambda event: (event.measurement.stamp_us, event.measurement.source))
    stamps = np.array([event.measurement.stamp_us for event in events], dtype=np.int64)
    r = np.array([event.innovation for event in events])
    return Innovations(stamps, r, np.array([event.S for event in events]))


def between(flight: Flight, start_us: int, end_us: int) -> Flight:
    """The innovations with start_us <= stamp < end_us."""
    return {key: part.between(start_us, end_us) for key, part in flight.items()}


def log_likelihood(flight: Flight) -> float:
    """The sum over all measurements."""
    return float(sum(part.log_likelihoods().sum() for part in flight.values()))


def is_same(flight: Flight, other: Flight) -> bool:
    """True where two runs have judged the same measurements."""
    return flight.keys() == other.keys() and all(
        np.array_equal(part.stamps, other[key].stamps) for key, part in flight.items()
    )


def lasting(flights: Sequence[Flight], aiding: str) -> float:
    """How much of an innovation is left in the next of its kind: their correlation, 0 where a model is right."""
    products, squares = 0.0, 0.0
    for flight in flights:
        for (name, _), part in flight.items():
            if name == aiding and len(part.stamps) > 1:
                white = np.linalg.solve(np.linalg.cholesky(part.S), part.r[..., None])[..., 0]
                white = np.clip(white, -ROBUST_SIGMAS, ROBUST_SIGMAS)
                products += float(np.sum(white[:-1] * white[1:]))
                squares += float(np.sum(white**2))
    return products / squares if squares > 0.0 else 0.0


def bounds_of(flight: Flight) -> tuple[int, int]:
    """The first and the last stamp."""
    stamps = [part.stamps for part in flight.values()]
    return min(int(t[0]) for t in stamps), max(int(t[-1]) for t in stamps)
