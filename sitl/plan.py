"""Flight plans: motion segments that lead from rest to rest, and the pose they command at any time.

A pose is [north, east, down, yaw] (m, m, m, rad) from the place where the vehicle stands. The
commanded motion is a trapezoid in speed; `trajectory` rounds its corners.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field

from mavins.errors import ScenarioError
from mavins.types import FloatArray
from sitl.settings import NonNegative, Positive, Settings


@dataclass(frozen=True, slots=True)
class Hover(Settings):
    """Stay where you are."""

    do: Literal["hover"]
    seconds: Positive


@dataclass(frozen=True, slots=True)
class TakeOff(Settings):
    """Climb straight up to `height` m above the start."""

    do: Literal["take_off"]
    height: Positive
    speed: Positive = 2.0
    acceleration: Positive = 1.5

    def way(self, start: FloatArray, s: FloatArray) -> FloatArray:
        """The poses (N, 4) after the shares s (N,) of the way."""
        return _straight(start, np.array([start[0], start[1], -self.height, start[3]]), s)

    def length(self, start: FloatArray) -> float:
        """The length of the way in m (for a turn, rad)."""
        return abs(self.height + float(start[2]))


@dataclass(frozen=True, slots=True)
class Land(Settings):
    """Descend straight down to the start's height."""

    do: Literal["land"]
    speed: Positive = 1.0
    acceleration: Positive = 1.0

    def way(self, start: FloatArray, s: FloatArray) -> FloatArray:
        """The poses (N, 4) after the shares s (N,) of the way."""
        return _straight(start, np.array([start[0], start[1], 0.0, start[3]]), s)

    def length(self, start: FloatArray) -> float:
        """The length of the way in m."""
        return abs(float(start[2]))


@dataclass(frozen=True, slots=True)
class Go(Settings):
    """Fly straight to a point, in m from the start, turning by `turn_deg` on the way.

    The height above the start stays unless it is given.
    """

    do: Literal["go"]
    north: float
    east: float
    height: float | None = None
    turn_deg: float = 0.0
    speed: Positive = 5.0
    acceleration: Positive = 2.0

    def way(self, start: FloatArray, s: FloatArray) -> FloatArray:
        """The poses (N, 4) after the shares s (N,) of the way."""
        return _straight(start, self._end(start), s)

    def length(self, start: FloatArray) -> float:
        """The length of the way in m."""
        return float(np.linalg.norm(self._end(start)[:3] - start[:3]))

    def _end(self, start: FloatArray) -> FloatArray:
        down = start[2] if self.height is None else -self.height
        return np.array([self.north, self.east, down, start[3] + math.radians(self.turn_deg)])


@dataclass(frozen=True, slots=True)
class Turn(Settings):
    """Turn on the spot by an angle, clockwise seen from above where it is positive."""

    do: Literal["turn"]
    by_deg: float
    rate_deg: Positive = 45.0
    acceleration_deg: Positive = 45.0

    @property
    def speed(self) -> float:
        """The yaw rate in rad/s."""
        return math.radians(self.rate_deg)

    @property
    def acceleration(self) -> float:
        """The yaw acceleration in rad/s^2."""
        return math.radians(self.acceleration_deg)

    def way(self, start: FloatArray, s: FloatArray) -> FloatArray:
        """The poses (N, 4) after the shares s (N,) of the way."""
        return _straight(start, start + np.array([0.0, 0.0, 0.0, math.radians(self.by_deg)]), s)

    def length(self, start: FloatArray) -> float:
        """The length of the way in rad."""
        return abs(math.radians(self.by_deg))


@dataclass(frozen=True, slots=True)
class Circle(Settings):
    """Fly `turns` circles (clockwise where positive) about a point, the nose turning along."""

    do: Literal["circle"]
    north: float
    east: float
    turns: float = 1.0
    speed: Positive = 5.0
    acceleration: Positive = 1.5

    def way(self, start: FloatArray, s: FloatArray) -> FloatArray:
        """The poses (N, 4) after the shares s (N,) of the way."""
        arm = start[:2] - [self.north, self.east]
        angle = 2.0 * math.pi * self.turns * s
        cos, sin = np.cos(angle), np.sin(angle)
        poses = np.tile(start, (len(s), 1))
        poses[:, 0] = self.north + cos * arm[0] - sin * arm[1]
        poses[:, 1] = self.east + sin * arm[0] + cos * arm[1]
        poses[:, 3] += angle
        return poses

    def length(self, start: FloatArray) -> float:
        """The length of the way in m."""
        radius = float(np.linalg.norm(start[:2] - [self.north, self.east]))
        return 2.0 * math.pi * abs(self.turns) * radius


@dataclass(frozen=True, slots=True)
class Figure8(Settings):
    """Fly the eight (a sin u, b sin 2u) with its crossing here, the nose turning with the course.

    `length_m` a and `width_m` b are half extents along and across `bearing_deg`; the height changes
    by `climb_m` sin u; `speed` is the one at the crossing.
    """

    do: Literal["figure8"]
    length_m: Positive
    width_m: Positive
    climb_m: NonNegative = 0.0
    bearing_deg: float = 0.0
    laps: Annotated[int, Field(ge=1)] = 1
    speed: Positive = 6.0
    acceleration: Positive = 2.0

    def way(self, start: FloatArray, s: FloatArray) -> FloatArray:
        """The poses (N, 4) after the shares s (N,) of the way."""
        u = 2.0 * math.pi * self.laps * s
        along, across = self.length_m * np.sin(u), self.width_m * np.sin(2.0 * u)
        bearing = math.radians(self.bearing_deg)
        course = np.unwrap(
            np.arctan2(2.0 * self.width_m * np.cos(2.0 * u), self.length_m * np.cos(u))
        )
        poses = np.tile(start, (len(s), 1))
        poses[:, 0] += math.cos(bearing) * along - math.sin(bearing) * across
        poses[:, 1] += math.sin(bearing) * along + math.cos(bearing) * across
        poses[:, 2] -= self.climb_m * np.sin(u)
        # the course is the same at both ends of a whole number of laps
        poses[:, 3] += course - math.atan2(2.0 * self.width_m, self.length_m)
        return poses

    def length(self, start: FloatArray) -> float:
        """The length in m that a vehicle at the crossing's speed would cover in the same time."""
        crossing = math.hypot(self.length_m, 2.0 * self.width_m, self.climb_m)
        return 2.0 * math.pi * self.laps * crossing


Segment: TypeAlias = Annotated[
    Hover | TakeOff | Land | Go | Turn | Circle | Figure8, Field(discriminator="do")
]


def _straight(start: FloatArray, end: FloatArray, s: FloatArray) -> FloatArray:
    poses: FloatArray = start + s[:, None] * (end - start)
    return poses


def travel_time(length: float, speed: float, acceleration: float) -> float:
    """The seconds from rest to rest over a length: speed up, cruise, slow down."""
    top = min(speed, math.sqrt(length * acceleration))
    return length / top + top / acceleration if length > 0.0 else 0.0


def travelled(tau: FloatArray, length: float, speed: float, acceleration: float) -> FloatArray:
    """The length covered (N,) after times tau (N,) from the start, at a trapezoid's speed.

    s = a/2 ([tau]^2 - [tau - r]^2 - [tau - T + r]^2 + [tau - T]^2), [x] = max(x, 0), r = v/a.
    """
    top = min(speed, math.sqrt(length * acceleration))
    ramp, total = top / acceleration, travel_time(length, speed, acceleration)
    covered = np.zeros_like(tau)
    for sign, corner in ((1, 0.0), (-1, ramp), (-1, total - ramp), (1, total)):
        covered += sign * 0.5 * acceleration * np.maximum(tau - corner, 0.0) ** 2
    return covered


def commanded(segments: Sequence[Segment], spacing: float) -> FloatArray:
    """The commanded poses (M, 4) at t = 0, h, 2h, ... until the last segment's end, from pose zero.

    Raises ScenarioError where the plan does not end in the pose it began with.
    """
    pose = np.zeros(4)
    poses = [pose[None, :]]
    begin = 0.0
    for segment in segments:
        if isinstance(segment, Hover):
            end = begin + segment.seconds
        else:
            length = segment.length(pose)
            end = begin + travel_time(length, segment.speed, segment.acceleration)
        first, beyond = math.floor(begin / spacing) + 1, math.floor(end / spacing) + 1
        t = spacing * np.arange(first, beyond, dtype=np.float64)
        if isinstance(segment, Hover) or length == 0.0:
            poses.append(np.tile(pose, (len(t), 1)))
        else:
            covered = travelled(t - begin, length, segment.speed, segment.acceleration)
            way = segment.way(pose, np.append(covered / length, 1.0))
            poses.append(way[:-1])
            pose = way[-1]
        begin = end
    turns = float(pose[3]) / (2.0 * math.pi)
    if np.max(np.abs(pose[:3])) > 1e-6 or abs(turns - round(turns)) > 1e-6:
        raise ScenarioError(
            "motion.segments: the plan must end where and as it began, but ends at"
            f" north {pose[0]:.3f} m, east {pose[1]:.3f} m, height {-pose[2]:.3f} m,"
            f" turned by {math.degrees(pose[3]):.1f} deg"
        )
    home = np.array([0.0, 0.0, 0.0, 2.0 * math.pi * round(turns)])
    return np.concatenate([*poses, home[None, :]])
