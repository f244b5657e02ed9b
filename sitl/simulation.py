"""The simulation: a scenario and a seed become measurements and truth, second after second.

Every random draw comes from one generator and in a fixed order, a block of one second at a time, so
a seed gives the same bytes at any speed and for any duration, and an endless run needs no more
memory. Stamps are whole microseconds since boot; the first are those of 1 s after boot.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavins.nav.rotations import yaws_of
from mavins.types import (
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuSample,
    ImuTable,
    IntArray,
    TruthSample,
)
from sitl.gnss import Receiver
from sitl.heading import Compass
from sitl.imu import Triad
from sitl.scenario import Scenario
from sitl.trajectory import Kinematics, Trajectory

START_US: Final = 1_000_000
BLOCK_US: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class TrueState:
    """The truth at one instant, and what ideal sensors read: f_b (3,) m/s^2, w_b (3,) rad/s."""

    sample: TruthSample
    f_b: FloatArray
    w_b: FloatArray


Event: TypeAlias = ImuSample | HeadingFix | GnssFix | TrueState


@dataclass(frozen=True, slots=True)
class TruthTable:
    """The truth at the IMU's stamps: p_n, v_n, biases b_g, b_a (N, 3), q_nb (N, 4) of any sign."""

    t_us: IntArray
    p_n: FloatArray
    v_n: FloatArray
    q_nb: FloatArray
    b_g: FloatArray
    b_a: FloatArray

    def __len__(self) -> int:
        return len(self.t_us)


@dataclass(frozen=True, slots=True)
class Measurements:
    """What a stretch of simulated time holds; `truth` has a row for each of `imu`'s."""

    imu: ImuTable
    truth: TruthTable
    headings: tuple[HeadingFix, ...]
    fixes: tuple[GnssFix, ...]
    states: tuple[TrueState, ...]

    def events(self) -> Iterator[Event]:
        """All in the order of their stamps, at one stamp IMU, heading, fix, truth."""
        rows = zip(self.imu.t_us.tolist(), self.imu.accel_b, self.imu.gyro_b, strict=True)
        imu = (ImuSample(t_us, accel_b, gyro_b) for t_us, accel_b, gyro_b in rows)
        return heapq.merge(imu, self.headings, self.fixes, self.states, key=stamp)


def stamp(event: Event) -> int:
    """The event's time in us since boot."""
    return event.sample.t_us if isinstance(event, TrueState) else event.t_us


class Simulation:
    """A scenario flown with a seed. Each iteration begins anew and has no end."""

    def __init__(self, scenario: Scenario, seed: int = 0) -> None:
        self.scenario = scenario
        self.seed = seed
        self.trajectory: Trajectory = scenario.trajectory()

    def __iter__(self) -> Iterator[Event]:
        for block in self.blocks():
            yield from block.events()

    def blocks(self) -> Iterator[Measurements]:
        """The measurements of one second after the other."""
        return self.measured(*(stream(*which) for stream, which in _streams(self.scenario)))

    def measured(
        self,
        motions: Iterable[Motion],
        yaws: Iterable[FloatArray],
        valid: Iterable[Kinematics],
        states: Iterable[tuple[TrueState, ...]],
    ) -> Iterator[Measurements]:
        """What the sensors make of what is true, second after second."""
        scenario, trajectory = self.scenario, self.trajectory
        rng = np.random.Generator(np.random.PCG64(self.seed))
        imu = scenario.imu
        gyro = Triad(imu.gyro, imu.rate, rng)
        accel = Triad(imu.accel, imu.rate, rng)
        compass = Compass(scenario.heading, rng)
        receiver = Receiver(scenario.gnss, trajectory.frame, trajectory.period, rng)
        truths = zip(motions, yaws, valid, states, strict=True)
        for second, (motion, yaw, at_fixes, true_states) in enumerate(truths):
            begin = START_US + second * BLOCK_US
            t_us, k = _stamps(begin, imu.rate), motion.k
            gyro_b, b_g = gyro.measure(motion.w_b, rng)
            accel_b, b_a = accel.measure(motion.f_b, rng)
            yield Measurements(
                ImuTable(t_us, accel_b, gyro_b),
                TruthTable(t_us, k.p_n, k.v_n, k.q_nb, b_g, b_a),
                compass.measure(_stamps(begin, scenario.heading.rate), yaw, rng),
                receiver.measure(_stamps(begin, scenario.gnss.rate), at_fixes, rng),
                true_states,
            )


@dataclass(frozen=True, slots=True)
class Motion:
    """A second of true motion at the IMU's stamps, and what an ideal one reads: w_b, f_b (N, 3)."""

    k: Kinematics
    w_b: FloatArray
    f_b: FloatArray


def _motions(trajectory: Trajectory, rate: int, integrate: bool) -> Iterator[Motion]:
    """At the IMU's stamps; the readings are values there, or means over the intervals before."""
    for begin in itertools.count(START_US, BLOCK_US):
        k = trajectory.at(_time(_stamps(begin, rate)))
        if integrate:
            dtheta, dv = trajectory.increments(k.t - 1.0 / rate, 1.0 / rate)
            yield Motion(k, dtheta * rate, dv * rate)
        else:
            yield Motion(k, *trajectory.inertial(k))


def _yaws(trajectory: Trajectory, rate: int) -> Iterator[FloatArray]:
    for begin in itertools.count(START_US, BLOCK_US):
        *_, q_lb = trajectory.local_level(trajectory.at(_time(_stamps(begin, rate))))
        yield yaws_of(q_lb)


def _at_fixes(trajectory: Trajectory, rate: int, latency: float) -> Iterator[Kinematics]:
    for begin in itertools.count(START_US, BLOCK_US):
        yield trajectory.at(_time(_stamps(begin, rate)) - latency)


def _states(trajectory: Trajectory, rate: int) -> Iterator[tuple[TrueState, ...]]:
    for begin in itertools.count(START_US, BLOCK_US):
        t_us = _stamps(begin, rate)
        k = trajectory.at(_time(t_us))
        w_b, f_b = trajectory.inertial(k)
        columns = (t_us, *trajectory.local_level(k))
        samples = (
            TruthSample(t, lat, lon, alt, tuple(v_l), tuple(q_lb))
            for t, (lat, lon, alt), v_l, q_lb in zip(*(c.tolist() for c in columns), strict=True)
        )
        yield tuple(map(TrueState, samples, f_b, w_b))


def _streams(scenario: Scenario) -> list[tuple[Callable[..., Iterator[Any]], tuple[Any, ...]]]:
    """What is true at the instants of each sensor, without end, and what that depends on: no seed."""
    trajectory, s = scenario.trajectory(), scenario
    return [
        (_motions, (trajectory, s.imu.rate, s.imu.integrate)),
        (_yaws, (trajectory, s.heading.rate)),
        (_at_fixes, (trajectory, s.gnss.rate, s.gnss.latency)),
        (_states, (trajectory, s.truth_rate)),
    ]


def simulate(scenario: Scenario, seed: int, duration: float) -> Measurements:
    """What the stream of this seed holds in its first `duration` s; other seeds of the scenario then take less time."""
    n_blocks = math.ceil(duration * 1e6 / BLOCK_US)
    known = [_known(stream, which, n_blocks) for stream, which in _streams(scenario)]
    blocks = list(Simulation(scenario, seed).measured(*known))
    if not blocks:
        raise ValueError("the duration must be positive")
    end_us = START_US + round(duration * 1e6)
    n = sum(int(np.count_nonzero(block.imu.t_us < end_us)) for block in blocks)
    imus, truths = [b.imu for b in blocks], [b.truth for b in blocks]
    return Measurements(
        ImuTable(*(_joined(imus, name)[:n] for name in ("t_us", "accel_b", "gyro_b"))),
        TruthTable(*(_joined(truths, name)[:n] for name in TruthTable.__slots__)),
        tuple(x for b in blocks for x in b.headings if x.t_us < end_us),
        tuple(x for b in blocks for x in b.fixes if x.t_us < end_us),
        tuple(x for b in blocks for x in b.states if x.sample.t_us < end_us),
    )


@functools.lru_cache(maxsize=8)
def _known(stream: Callable[..., Iterator[Any]], which: tuple[Any, ...], n: int) -> tuple[Any, ...]:
    """The first n seconds of a stream: of two scenarios, all of theirs."""
    return tuple(itertools.islice(stream(*which), n))


def _joined(tables: Iterable[object], name: str) -> NDArray[Any]:
    return np.concatenate([getattr(table, name) for table in tables])


def _stamps(begin_us: int, rate: int) -> IntArray:
    return begin_us + BLOCK_US // rate * np.arange(rate, dtype=np.int64)


def _time(t_us: IntArray) -> FloatArray:
    return (t_us - START_US).astype(np.float64) / 1e6
