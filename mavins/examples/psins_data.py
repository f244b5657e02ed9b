"""The PSINS scenario with a lever arm and a time offset: what its sensors are, and its file turned into our axes.

A car-like way of 966 s at 10 m/s: IMU increments at 100 Hz, GNSS at 1 Hz whose antenna is off the IMU and whose stamps
are early. Axes are ours: body forward, right, down; local level north, east, down. Source: a run of the PSINS toolbox.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mavins.types import FloatArray

RATE: Final = 100
"""IMU samples a second."""
STEP: Final = 1.0 / RATE
GRAVITY: Final = 9.780325
"""m/s^2 in a g, as the sensors' figures are given."""

GYRO_BIAS: Final = math.radians(0.03) / 3600.0
ACCEL_BIAS: Final = 100e-6 * GRAVITY
GYRO_NOISE: Final = math.radians(0.001) / 60.0
ACCEL_NOISE: Final = 10e-6 * GRAVITY
"""1-sigma of the constant biases in rad/s and m/s^2, root PSDs in rad/s/sqrt(Hz) and m/s^2/sqrt(Hz)."""
POSITION_NOISE: Final = np.array([1.54, 1.34, 4.55])
VELOCITY_NOISE: Final = np.full(3, 0.16)
NOISE_TIME: Final = 1.0
"""GNSS noise is a first-order Markov process: 1-sigma north, east, down in m and m/s, correlation time in s."""
LEVER_B: Final = np.array([2.0, 1.0, -3.0])
DELAY: Final = -0.1
"""The antenna's place in b (m); a fix stamped t is where the antenna is at t + 0.1 s."""

START_SIGMA: Final = np.concatenate(
    [[1.0, 1.0, 3.0], np.full(3, 0.1), np.radians([0.5, 0.5, 30.0]) / 60.0]
)
"""1-sigma at the start, along and about the axes of n: position in m, velocity in m/s, attitude in rad."""
START_ERROR: Final = START_SIGMA * [1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0]
"""The errors of the published run: what it adds to the truth."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One run. Sample k is over the interval that ends at (k + 1) STEP, fix k is stamped k s.

    `increments` (N, 6): integrals of rate (rad) and specific force (m/s). `fix_lla` (M, 3) rad, rad, m; `fix_v_l`
    (M, 3). Truth each 0.1 s, from 0.1 s on: `lla` (T, 3), `v_l` (T, 3), `euler` (T, 3) roll, pitch, yaw.
    """

    increments: FloatArray
    fix_lla: FloatArray
    fix_v_l: FloatArray
    lla: FloatArray
    v_l: FloatArray
    euler: FloatArray


def read_psins(path: Path) -> tuple[Flight, FloatArray]:
    """The file's run, and its segments (S, 8): duration, start speed, Euler rates (pitch, roll, -yaw), acceleration."""
    with np.load(path) as file:
        imu, gps = file["imu_increments"], file["gps_position"]
        truth, segments = file["truth"], file["segments"]
    frd = [1, 0, 2]
    signs = np.array([1.0, 1.0, -1.0])
    increments = np.hstack([imu[:, :3][:, frd] * signs, imu[:, 3:6][:, frd] * signs])
    return Flight(
        np.ascontiguousarray(increments),
        np.ascontiguousarray(gps[:, 3:6]),
        gps[:, :3][:, frd] * signs,
        np.ascontiguousarray(truth[:, 6:9]),
        truth[:, 3:6][:, frd] * signs,
        np.ascontiguousarray(truth[:, :3][:, frd] * signs),
    ), segments
