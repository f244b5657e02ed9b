"""Zero-velocity aided inertial navigation: an IMU on a foot, and nothing else.

The error-state filter walks through the IMU rows and is told `v_n = 0` at each row where the detector finds the foot
standing. One setting, below, is for all walks and runs of both sets of data. Source: OpenShoe (Nilsson, Skog, Handel
and Hari, 2012). Theory: docs/theory/zero_velocity.md; page: docs/tutorials/foot-mounted.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavins.aiding import zero_velocity
from mavins.aiding.detectors import AdaptiveThreshold, Detector
from mavins.estimator.alignment import Start, initial_state
from mavins.examples.base import Figure, MissingDataError, needed
from mavins.examples.drawing import pyplot
from mavins.examples.foot_data import Recording, read_openshoe, read_vicon
from mavins.filters import FilterState, ImuNoise, RowBlock, make
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import Layout
from mavins.types import FloatArray, Origin

DETECTOR: Final = Detector("shoe")
THRESHOLD: Final = AdaptiveThreshold()
RATE: Final = Detector("ared", sigma_gyro=1.0)
"""The mean square of the rate over the same window, in (rad/s)^2."""
NOISE: Final = ImuNoise(gyro=2e-4, accel=0.03, gyro_bias_walk=0.0, accel_bias_walk=0.0)
STILL_SIGMA: Final = 0.01
ROLL_RADIUS: Final = 0.1
"""A standing foot rolls over its sole: a sensor this far (m) from the ground moves at the rate times this."""
LEVELLING_US: Final = 100_000
TILT_SIGMA: Final = 0.01
GYRO_BIAS_SIGMA: Final = 1e-5
"""The gyros' bias (rad/s) is taken as removed: v = 0 does not show the heading, and a free bias would take up what the
gyros do wrong in each step's shock."""
ACCEL_BIAS_SIGMA: Final = 0.03

OPENSHOE_ORIGIN: Final = Origin(math.radians(58.0), 0.0, 100.0)
VICON_ORIGIN: Final = Origin(math.radians(43.7), math.radians(-79.4), 100.0)
LOOP_LIMIT: Final = 0.65
TRIAL_LIMIT: Final = 0.11


@dataclass(frozen=True, slots=True)
class Walk:
    """What the filter makes of a recording: positions p_n (N, 3) in m, and where it was told that the foot stands."""

    recording: Recording
    p_n: FloatArray
    standing: NDArray[np.bool_]

    @property
    def length(self) -> float:
        """Metres walked, by the steps' ends: each swing counts as the straight line below it."""
        ends = self.p_n[np.flatnonzero(self.standing), :2]
        return float(np.linalg.norm(np.diff(ends, axis=0), axis=1).sum())


def run(data: Path | None, out: Path | None, say: Callable[[str], None]) -> Sequence[Figure]:
    """Both sets of data."""
    loops = _files(needed(data, "zupt", "openshoe"), "loop_*.txt.xz")
    trials = _files(needed(data, "zupt", "vicon"), "*.npz")
    say("closed loops (OpenShoe): how far the end is from the start")
    say(
        f"{'loop':<21}{'s':>6}{'m':>7}{'standing':>10}{'horizontal':>12}{'vertical':>10}{'3-D m':>8}"
    )
    walks, errors = [], []
    for path in loops:
        walk = navigate(read_openshoe(path), OPENSHOE_ORIGIN)
        d = walk.p_n[-1] - walk.p_n[0]
        walks.append(walk)
        errors.append(float(np.linalg.norm(d)))
        say(f"{_start_of_line(walk)}{math.hypot(d[0], d[1]):12.3f}{d[2]:10.3f}{errors[-1]:8.3f}")
    say("")
    say("motion-capture trials: RMS of the horizontal error, as it is and after one turn in yaw")
    say(
        f"{'trial':<21}{'s':>6}{'m':>7}{'standing':>10}{'as it is':>12}{'turn deg':>10}{'RMS m':>8}"
    )
    turned, rms = [], []
    for path in trials:
        walk = navigate(read_vicon(path), VICON_ORIGIN)
        truth = walk.recording.truth
        assert truth is not None
        raw = horizontal_rms(walk.p_n[:, :2] - walk.p_n[0, :2], truth)
        yaw, track = turned_onto(walk.p_n[:, :2], truth)
        turned.append((walk, track))
        rms.append(horizontal_rms(track, truth))
        say(f"{_start_of_line(walk)}{raw:12.3f}{math.degrees(yaw):10.1f}{rms[-1]:8.3f}")
    say("")
    plot = None if out is None else pyplot(say)
    if plot is not None and out is not None:
        draw(plot, out / "openshoe.png", [(walk, walk.p_n[:, :2]) for walk in walks])
        draw(plot, out / "vicon.png", turned)
    return [
        Figure(f"mean final error of {len(loops)} loops", float(np.mean(errors)), LOOP_LIMIT, "m"),
        Figure(f"mean RMS error of {len(trials)} trials", float(np.mean(rms)), TRIAL_LIMIT, "m"),
    ]


def navigate(recording: Recording, origin: Origin) -> Walk:
    """Walk the filter through a recording."""
    frame = TangentFrame.at(origin)
    t_us, imu = recording.t_us, recording.imu
    algorithm = make("eskf", NOISE)
    state = start_state(recording, frame, algorithm.layout)
    algorithm.adopt(state)
    statistics = DETECTOR.statistics(imu)
    standing = statistics < THRESHOLD.over_log(t_us, statistics)
    sigma = np.hypot(STILL_SIGMA, ROLL_RADIUS * np.sqrt(RATE.statistics(imu)))
    rows = RowBlock.empty(len(t_us))
    p_n = np.zeros((len(t_us), 3))
    done = 1
    # from one standing row to the next; the rows of a swing are walked in one go
    for k in np.flatnonzero(standing[1:]) + 1:
        walked = slice(done, k + 1)
        stamp = int(t_us[k])
        rows.count = 0
        algorithm.walk(state, frame, t_us[walked], imu[walked], stamp, int(t_us[done - 1]), 0, rows)
        algorithm.update(
            state, zero_velocity.measure(stamp, stamp, float(sigma[k]), math.inf), math.inf
        )
        p_n[walked] = rows.x[: rows.count, :3]
        p_n[k] = state.x[:3]
        done = int(k) + 1
    if done < len(t_us):
        rows.count = 0
        last, before = int(t_us[-1]), int(t_us[done - 1])
        algorithm.walk(state, frame, t_us[done:], imu[done:], last, before, 0, rows)
        p_n[done:] = rows.x[: rows.count, :3]
    return Walk(recording, p_n, standing)


def start_state(recording: Recording, frame: TangentFrame, layout: Layout) -> FilterState:
    """At rest at the origin, facing north, levelled by the first tenth of a second."""
    imu = recording.imu
    first = imu[recording.t_us <= recording.t_us[0] + LEVELLING_US]
    start = Start(
        accel_b=first[:, 3:].mean(axis=0),
        push_n=-gravity_n(np.zeros(3), frame.r0_e, frame.C_ne),
        yaw_n=0.0,
        p_n=np.zeros(3),
        R_p=np.eye(3) * 1e-6,
        v_n=np.zeros(3),
        R_v=np.eye(3) * STILL_SIGMA**2,
        b_g=np.zeros(3),
        sigma_b_g=GYRO_BIAS_SIGMA,
        sigma_b_a=ACCEL_BIAS_SIGMA,
        sigma_tilt=TILT_SIGMA,
        sigma_yaw=0.0,
        lever_b=np.zeros(3),
    )
    x, P = initial_state(start, layout)
    return FilterState(x, P, imu[0].copy(), int(recording.t_us[0]))


def turned_onto(track: FloatArray, truth: FloatArray) -> tuple[float, FloatArray]:
    """(yaw, track (N, 2)): the track moved to begin where the truth does, turned about there to lie nearest to it."""
    a, b = track - track[0], truth - truth[0]
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    c, s = math.cos(yaw), math.sin(yaw)
    return yaw, a @ np.array([[c, s], [-s, c]])


def horizontal_rms(track: FloatArray, truth: FloatArray) -> float:
    """RMS distance in m of tracks (N, 2), of which the first begins at zero."""
    return float(np.sqrt(((track - (truth - truth[0])) ** 2).sum(axis=1).mean()))


def _files(folder: Path, pattern: str) -> list[Path]:
    found = sorted(folder.glob(pattern))
    if not found:
        raise MissingDataError(f"{folder} has no {pattern}")
    return found


def _start_of_line(walk: Walk) -> str:
    t_us = walk.recording.t_us
    seconds = (t_us[-1] - t_us[0]) * 1e-6
    share = 100.0 * walk.standing.mean()
    return f"{walk.recording.name:<21}{seconds:6.1f}{walk.length:7.1f}{share:8.0f} %"


def draw(plot: Any, path: Path, tracks: Sequence[tuple[Walk, FloatArray]]) -> None:
    """A picture of the tracks (N, 2) of a set, beside the true ones where they are known."""
    columns = min(4, len(tracks))
    rows = -(-len(tracks) // columns)
    figure, axes = plot.subplots(
        rows, columns, squeeze=False, figsize=(4.0 * columns, 3.6 * rows), layout="tight"
    )
    for axis in axes.flat[len(tracks) :]:
        axis.remove()
    for axis, (walk, track) in zip(axes.flat, tracks, strict=False):
        truth = walk.recording.truth
        if truth is not None:
            axis.plot(*(truth - truth[0]).T[::-1], "k", linewidth=0.8, label="truth")
        axis.plot(*track.T[::-1], linewidth=0.8, label="estimate")
        axis.plot(*track[[0, -1]].T[::-1], "o", markersize=4, label="start and end")
        axis.set(title=walk.recording.name, xlabel="right m", ylabel="forward m")
        axis.set_aspect("equal", adjustable="datalim")
    axes.flat[0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plot.close(figure)
