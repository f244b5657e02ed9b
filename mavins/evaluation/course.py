"""A course: the states that a vehicle goes through, and the measurements that it gets on the way.

Theory: docs/theory/observability.md.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.aiding import Measurement
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.fusion import Event
from mavins.evaluation.tape import Tape
from mavins.filters import RowBlock
from mavins.filters.walking import HOLD_US
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import quat_conj, quat_log, quat_mul, quat_to_dcm
from mavins.types import FloatArray, IntArray

AT_REST: Final = 0.3
"""A vehicle whose speed stays below this (m/s) rests, on the ground or in the air: to an INS they are the same."""
ACCELERATING: Final = 0.5
TURNING: Final = math.radians(5.0)
CLIMBING: Final = 0.3
"""Means over a segment above which it has this name: m/s^2, rad/s about the vertical, m/s up or down."""


@dataclass(frozen=True, slots=True)
class Course:
    """States `x` (N, 26) with IMU readings `u` (N, 6) at instants `t_us` (N,), without gaps, and measurements."""

    frame: TangentFrame
    t_us: IntArray
    x: FloatArray
    u: FloatArray
    measurements: tuple[Measurement, ...]

    def without(self, aidings: tuple[str, ...]) -> Course:
        """The same course with these aidings missing."""
        left = tuple(m for m in self.measurements if m.aiding not in aidings)
        return dataclasses.replace(self, measurements=left)

    def until(self, duration: float) -> Course:
        """The first `duration` s."""
        n = int(np.searchsorted(self.t_us, self.t_us[0] + round(duration * 1e6), "right"))
        return dataclasses.replace(self, t_us=self.t_us[:n], x=self.x[:n], u=self.u[:n])


def estimated(tape: Tape) -> Course:
    """The course that the filter `eskf` finds: its longest stretch of estimates without a gap, and what it fused."""
    tables: dict[int, tuple[TangentFrame, list[RowBlock]]] = {}
    fused: list[Measurement] = []

    def take(block: RowBlock, frame: TangentFrame) -> None:
        n = block.count
        rows = RowBlock(
            block.t_us[:n].copy(), block.x[:n].copy(), block.u[:n].copy(), np.empty((n, 0, 0)), n
        )
        tables.setdefault(id(frame), (frame, []))[1].append(rows)

    def decide(event: Event) -> None:
        if event.accepted:
            fused.append(event.measurement)

    # with the delay as a state, a measurement knows how much of the acceleration around it is noise
    states = dataclasses.replace(tape.settings.states, gnss_delay="estimate")
    settings = dataclasses.replace(tape.settings, states=states)
    tape.play(Estimator(settings, "eskf", Outputs(0, take, decide)))
    stretches = [s for frame, blocks in tables.values() for s in _stretches(frame, blocks)]
    if not stretches:
        raise LogFormatError(
            "no estimates in this log, so no course; see why with: mavins replay LOG"
        )
    longest = max(stretches, key=lambda s: int(s.t_us[-1] - s.t_us[0]))
    measurements = tuple(sorted(fused, key=lambda m: m.t_us))
    return dataclasses.replace(longest, measurements=measurements)


def _stretches(frame: TangentFrame, blocks: list[RowBlock]) -> list[Course]:
    t_us = np.concatenate([b.t_us for b in blocks])
    x = np.concatenate([b.x for b in blocks])
    u = np.concatenate([b.u for b in blocks])
    cuts = np.flatnonzero(np.diff(t_us) > HOLD_US) + 1
    parts = zip(np.split(t_us, cuts), np.split(x, cuts), np.split(u, cuts), strict=True)
    return [Course(frame, *part, ()) for part in parts if len(part[0]) > 1]


def label_of(course: Course, first: int, last: int) -> str:
    """What the vehicle does from one sample to another, by its mean acceleration, turn rate and vertical speed."""
    t_us, x = course.t_us[first : last + 1], course.x[first : last + 1]
    seconds = max(1, round(float(t_us[-1] - t_us[0]) * 1e-6))
    at = np.unique(np.searchsorted(t_us, np.linspace(t_us[0], t_us[-1], seconds + 1).round()))
    dt = np.diff(t_us[at]) * 1e-6
    v, q = x[at, 3:6], x[at, 6:10]
    if np.linalg.norm(x[:, 3:6], axis=1).max() < AT_REST:
        moves = []
    else:
        acceleration = np.linalg.norm(np.diff(v, axis=0), axis=1) / dt
        found = {
            "accelerating": acceleration.mean() > ACCELERATING,
            "climbing": np.abs(v[:, 2]).mean() > CLIMBING,
        }
        moves = [name for name, yes in found.items() if yes] or ["straight"]
    turns = [
        quat_to_dcm(a)[2] @ quat_log(quat_mul(quat_conj(a), b)) for a, b in itertools.pairwise(q)
    ]
    if (np.abs(turns) / dt).mean() > TURNING:
        moves = [*(m for m in moves if m != "straight"), "turning"]
    return ", ".join(moves) or "at rest"
