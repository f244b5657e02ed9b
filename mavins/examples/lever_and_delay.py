"""An antenna off the IMU, and fixes whose stamps are wrong: the error-state filter finds both (article 004).

Three systems: 153, position alone; 186, position and velocity; 193, position with the lever arm and the time offset as
states. 193 runs on the published record, all three on seeds of its way. Then a recorded flight (delayed_flight.py).
One setting serves all runs: the sensors' own figures, `STILL_SIGMA`, and what is known of lever arm and offset before.
Page: docs/tutorials/lever-and-delay.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mavins.aiding.gnss_velocity import surroundings
from mavins.evaluation.consistency import band, errors, nees
from mavins.examples import delayed_flight
from mavins.examples.base import Figure, needed
from mavins.examples.integrating import run_through
from mavins.examples.psins_data import (
    ACCEL_BIAS,
    ACCEL_NOISE,
    DELAY,
    GYRO_BIAS,
    GYRO_NOISE,
    LEVER_B,
    NOISE_TIME,
    POSITION_NOISE,
    RATE,
    START_ERROR,
    START_SIGMA,
    STEP,
    VELOCITY_NOISE,
    Flight,
    read_psins,
)
from mavins.examples.psins_flight import Way, fly, noisy
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import (
    B_A,
    B_G,
    CANONICAL_SIZE,
    CORE,
    L_B,
    P_N,
    TAU,
    THETA_B,
    V_N,
    X_L,
    X_P,
    X_Q,
    X_SIZE,
    X_TAU,
    X_V,
    Layout,
)
from mavins.nav.so3 import dcm_to_quat, euler_to_quat, quat_exp, quat_mul, quat_to_dcm
from mavins.types import FloatArray, IntArray, Origin

LEVER_SIGMA: Final = 3.0
DELAY_SIGMA: Final = 0.1
"""The antenna is within some metres of the IMU, the stamps are right to a tenth of a second: both start from zero."""
STILL_SIGMA: Final = 0.02
"""A vehicle that stands moves by less than this (m/s)."""
NOISE: Final = np.array([GYRO_NOISE, ACCEL_NOISE, 0.0, 0.0])
SEEDS: Final = 20
ROWS_EVERY: Final = RATE // 10
JUDGED: Final = 1000
"""The last 100 s at ten rows a second."""
SETTLED: Final = 2000
SPARSE: Final = 100
"""The NEES of the simulated runs counts from 200 s on, each 10 s."""
ARCSEC: Final = math.degrees(1.0) * 3600.0


@dataclass(frozen=True, slots=True)
class System:
    """What a filter estimates and is told. With `offsets` the antenna is off, and the states know that it may be."""

    name: str
    offsets: bool
    velocity: bool = False
    still_sigma: float = STILL_SIGMA

    @property
    def layout(self) -> Layout:
        """Its error states, those of the GNSS noise aside."""
        return Layout.of((*CORE, "l_b", "tau") if self.offsets else CORE)


POSITION: Final = System("153", offsets=False)
VELOCITY: Final = System("186", offsets=False, velocity=True)
OFFSETS: Final = System("193, standing known", offsets=True)
BARE: Final = System("193, position only", offsets=True, still_sigma=0.0)


@dataclass(frozen=True, slots=True)
class Track:
    """What a system makes of a flight: rows each 0.1 s, and the errors (JUDGED, 15) of the last."""

    frame: TangentFrame
    rows: RowBlock
    last: FloatArray

    @property
    def yaw(self) -> tuple[float, float]:
        """RMS of the yaw's error over the last 100 s, and of its sigma: the vehicle stands there, level. Arcsec."""
        variance = self.rows.P[-len(self.last) :, 8, 8].mean()
        return ARCSEC * math.sqrt((self.last[:, 8] ** 2).mean()), ARCSEC * math.sqrt(variance)

    @property
    def lever(self) -> tuple[FloatArray, FloatArray]:
        """The last estimate of the lever arm and its sigma (3,) in m."""
        return self.rows.x[-1, X_L], np.sqrt(np.diagonal(self.rows.P[-1])[L_B])

    @property
    def delay(self) -> tuple[float, float]:
        """The same of the delay in s."""
        return float(self.rows.x[-1, X_TAU]), math.sqrt(self.rows.P[-1, TAU, TAU].item())


def run(data: Path | None, out: Path | None, say: Callable[[str], None]) -> Sequence[Figure]:
    """The record, its like over seeds, and the flight."""
    path = needed(data, "psins", "psins_193.npz")
    log = path.parents[2] / "recordings" / delayed_flight.NAME
    flight, segments = read_psins(path)
    lines: list[str] = []

    def note(line: str) -> None:
        say(line)
        lines.append(line)

    figures = list(_record(flight, note))
    _seeds(fly(segments, flight.lla[0]), note)
    if log.exists():
        figures += delayed_flight.fly(log, note)
    else:
        note(f"{log} is missing: the flight is left out")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "lever-and-delay.txt").write_text("\n".join(lines) + "\n")
    return figures


def _record(flight: Flight, say: Callable[[str], None]) -> Sequence[Figure]:
    """193 on the record."""
    say(
        "the record: yaw over the last 100 s, lever arm (forward, right, down) and delay at the end"
    )
    say(
        f"{'system':<20}{'yaw arcsec':>11}{'sigma':>7}   {'lever m':^21}{'sigma':^18}{'delay s':>10}{'sigma':>7}"
    )
    for system in (BARE, dataclasses.replace(BARE, name="and velocity", velocity=True), OFFSETS):
        track = navigate(system, flight, START_ERROR)
        (yaw, sd_yaw), (lever, sd_lever), (delay, sd_delay) = track.yaw, track.lever, track.delay
        say(
            f"{system.name:<20}{yaw:11.0f}{sd_yaw:7.0f}   "
            + "".join(f"{v:7.2f}" for v in lever)
            + "".join(f"{v:6.2f}" for v in sd_lever)
            + f"{delay:10.3f}{sd_delay:7.3f}"
        )
    say("")
    off, late = np.abs(lever - LEVER_B), abs(delay - DELAY)
    return [
        Figure("yaw RMS", yaw, 138.0, "arcsec"),
        Figure("yaw RMS in its sigmas", yaw / sd_yaw, 3.0),
        Figure("lever arm, largest error", float(off.max()), 0.3, "m"),
        Figure("lever arm, largest error in its sigmas", float((off / sd_lever).max()), 3.0),
        Figure("delay, error", late, 0.03, "s"),
        Figure("delay, error in its sigmas", late / sd_delay, 3.0),
    ]


def _seeds(way: Way, say: Callable[[str], None]) -> None:
    """All systems on seeds of the way, reported."""
    low, high = band(9, SEEDS)
    say(f"{SEEDS} simulated seeds: median of the yaw's RMS over the last 100 s, RMS of the rest")
    say(
        f"{'system':<20}{'yaw arcsec':>11}{'sigma':>7}{'lever m':>9}{'delay s':>9}{'NEES of 9':>11}{'in band':>9}"
    )
    for system in (POSITION, VELOCITY, BARE, OFFSETS):
        yaws, levers, delays, values = [], [], [], []
        for seed in range(SEEDS):
            random = np.random.default_rng(seed)
            error = random.normal(size=9) * START_SIGMA
            off = (LEVER_B, DELAY) if system.offsets else (np.zeros(3), 0.0)
            flight = noisy(way, random, *off)
            track = navigate(system, flight, error)
            yaws.append(track.yaw)
            if system.offsets:
                levers.append(track.lever[0] - LEVER_B)
                delays.append(track.delay[0] - DELAY)
            at = np.arange(SETTLED, len(flight.lla), SPARSE, dtype=np.int64)
            e = errors(true_states(flight, track.frame, at), track.rows.x[at, :X_SIZE])
            values.append(nees(e, track.rows.P[at]))
        yaw, sd_yaw = np.median(yaws, axis=0)
        mean = np.mean(values, axis=0)
        inside = np.mean((mean >= low) & (mean <= high))
        extra = f"{'':18}"
        if system.offsets:
            lever = math.sqrt(np.mean(np.square(levers)))
            extra = f"{lever:9.2f}{math.sqrt(np.mean(np.square(delays))):9.3f}"
        say(
            f"{system.name:<20}{yaw:11.0f}{sd_yaw:7.0f}{extra}{mean.mean():11.2f}{100.0 * inside:7.0f} %"
        )
    say(
        f"the mean NEES over the seeds should be within {low:.2f} and {high:.2f} at 95 % of the instants"
    )
    say("")


def navigate(system: System, flight: Flight, error: FloatArray) -> Track:
    """A system through a flight from the truth plus an `error` (9,) as in START_SIGMA."""
    lla = flight.lla[0]
    frame = TangentFrame.at(Origin(float(lla[0]), float(lla[1]), float(lla[2])))
    sigma = np.concatenate([POSITION_NOISE, VELOCITY_NOISE])[: 6 if system.velocity else 3]
    x, P = start(flight, frame, error, sigma)
    noises = np.arange(CANONICAL_SIZE, CANONICAL_SIZE + len(sigma))
    columns = np.concatenate([system.layout.columns, noises])
    P = np.ascontiguousarray(P[np.ix_(columns, columns)])
    fixes = np.array([frame.from_lla(*place) for place in flight.fix_lla])
    if system.velocity:
        fixes = np.hstack([fixes, flight.fix_v_l])
    around = np.array(
        [
            surroundings(lat, lon, alt, frame.r0_e, frame.C_ne)
            for lat, lon, alt in flight.fix_lla.tolist()
        ]
    )
    count = len(flight.increments) // ROWS_EVERY
    rows = RowBlock(
        np.empty(count, dtype=np.int64),
        np.empty((count, len(x))),
        np.empty((count, 6)),
        np.empty((count, len(P), len(P))),
        count,
    )
    run_through(
        x,
        P,
        columns,
        flight.increments,
        round(STEP * 1e6),
        NOISE,
        frame.r0_e,
        frame.C_ne,
        frame.w_ie_n,
        fixes,
        around,
        sigma,
        math.exp(-1.0 / NOISE_TIME),
        system.still_sigma,
        ROWS_EVERY,
        rows.t_us,
        rows.x,
        rows.u,
        rows.P,
    )
    at = np.arange(count - JUDGED, count, dtype=np.int64)
    last = errors(true_states(flight, frame, at), rows.x[at, :X_SIZE])
    return Track(frame, rows, last)


def start(
    flight: Flight, frame: TangentFrame, error: FloatArray, noise_sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(x, P) over all canonical errors and those of the GNSS noise: the truth plus an error, lever arm and delay 0."""
    x = np.zeros(X_SIZE + len(noise_sigma))
    x[:X_SIZE] = true_states(flight, frame, np.zeros(1, dtype=np.int64))[0]
    x[X_P] += error[:3]
    x[X_V] += error[3:6]
    x[X_Q] = quat_mul(quat_exp(error[6:9]), x[X_Q])
    C = quat_to_dcm(x[X_Q])
    variances = np.zeros(CANONICAL_SIZE + len(noise_sigma))
    variances[P_N] = START_SIGMA[:3] ** 2
    variances[V_N] = START_SIGMA[3:6] ** 2
    variances[B_G] = GYRO_BIAS**2
    variances[B_A] = ACCEL_BIAS**2
    variances[L_B] = LEVER_SIGMA**2
    variances[TAU] = DELAY_SIGMA**2
    variances[CANONICAL_SIZE:] = noise_sigma**2
    P = np.diag(variances)
    P[THETA_B, THETA_B] = C.T @ np.diag(START_SIGMA[6:9] ** 2) @ C
    return x, P


def true_states(flight: Flight, frame: TangentFrame, at: IntArray) -> FloatArray:
    """The nominal states (K, 26) that rows `at` (K,) of the truth are, with zero biases."""
    x = np.zeros((len(at), X_SIZE))
    for state, k in zip(x, at.tolist(), strict=True):
        lat, lon, alt = flight.lla[k].tolist()
        C_nl = np.ascontiguousarray(frame.local_level(lat, lon).T)
        state[X_P] = frame.from_lla(lat, lon, alt)
        state[X_V] = C_nl @ flight.v_l[k]
        state[X_Q] = quat_mul(dcm_to_quat(C_nl), euler_to_quat(*flight.euler[k]))
    return x
