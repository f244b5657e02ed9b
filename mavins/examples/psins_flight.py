"""Further runs of the PSINS scenario: the way of its segments, as ideal sensors feel it, and noise of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavins.examples.psins_data import (
    ACCEL_BIAS,
    ACCEL_NOISE,
    GYRO_BIAS,
    GYRO_NOISE,
    NOISE_TIME,
    POSITION_NOISE,
    RATE,
    STEP,
    VELOCITY_NOISE,
    Flight,
)
from mavins.nav.earth import E2, EARTH_RATE, SEMI_MAJOR, normal_gravity
from mavins.types import FloatArray


@dataclass(frozen=True, slots=True)
class Way:
    """A true way: `increments` (N, 6) as in Flight; `lla`, `v_l`, `euler`, `w_b` (N + 1, 3) at the samples' edges."""

    increments: FloatArray
    lla: FloatArray
    v_l: FloatArray
    euler: FloatArray
    w_b: FloatArray


def fly(segments: FloatArray, start_lla: FloatArray) -> Way:
    """What ideal sensors feel on the way that the segments make.

    Euler angles and speed along the body's forward axis are linear in time within a segment. The integrals over a
    sample are two-point Gauss sums, whose nodes never touch a corner.
    """
    ends = np.concatenate([[0.0], np.cumsum(segments[:, 0])])
    slopes = np.column_stack([segments[:, 3], segments[:, 2], -segments[:, 4], segments[:, 6]])
    corners = np.vstack([np.zeros(4), np.cumsum(slopes * segments[:, :1], axis=0)])

    def at(t: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(t, ends, column) for column in corners.T])

    count = round(ends[-1] * RATE)
    edges = np.arange(count + 1) * STEP
    reach = 0.5 / math.sqrt(3.0) * STEP
    nodes = (edges[:-1, None] + 0.5 * STEP + np.array([-reach, reach])).ravel()
    here = at(nodes)
    rates = slopes[np.clip(np.searchsorted(ends, nodes) - 1, 0, len(slopes) - 1)]
    v_edges = _velocity(at(edges))
    v_nodes = _velocity(here)
    lla = _places(v_nodes, start_lla)
    lla_nodes = 0.5 * (lla[:-1] + lla[1:]).repeat(2, axis=0)
    lla_nodes += (
        np.tile([-reach, reach], count)[:, None] * np.diff(lla, axis=0).repeat(2, axis=0) * RATE
    )
    w_b, f_b = _sensed(here, rates, v_nodes, lla_nodes)
    both = np.hstack([w_b, f_b]).reshape(count, 2, 6)
    w_edges = np.vstack([both[:1, :, :3].mean(axis=1), both[:, :, :3].mean(axis=1)])
    return Way(both.mean(axis=1) * STEP, lla, v_edges, at(edges)[:, :3], w_edges)


def _velocity(pose: FloatArray) -> FloatArray:
    """v_l (N, 3) of roll, pitch, yaw and forward speed (N, 4)."""
    _, pitch, yaw, speed = pose.T
    level = speed * np.cos(pitch)
    return np.column_stack([level * np.cos(yaw), level * np.sin(yaw), -speed * np.sin(pitch)])


def _radii(lat: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radii of curvature (m) along the meridian and across it."""
    across = SEMI_MAJOR / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    return across**3 * (1.0 - E2) / SEMI_MAJOR**2, across


def _places(v_nodes: FloatArray, start_lla: FloatArray) -> FloatArray:
    """Lat, lon, alt at the edges (N + 1, 3), from velocities at the two nodes of each sample (2N, 3)."""
    moved = np.vstack(
        [np.zeros(3), np.cumsum(v_nodes.reshape(-1, 2, 3).mean(axis=1) * STEP, axis=0)]
    )
    alt = start_lla[2] - moved[:, 2]
    lat, lon = np.full(len(moved), start_lla[0]), np.full(len(moved), start_lla[1])
    steps = np.diff(moved, axis=0)
    for _ in range(4):  # the radii change by 1e-3 over the flight: each round gains three digits
        along, across = _radii(lat)
        north = steps[:, 0] / (along + alt)[1:]
        east = steps[:, 1] / ((across + alt) * np.cos(lat))[1:]
        lat = start_lla[0] + np.concatenate([[0.0], np.cumsum(north)])
        lon = start_lla[1] + np.concatenate([[0.0], np.cumsum(east)])
    return np.column_stack([lat, lon, alt])


def _sensed(
    pose: FloatArray, rates: FloatArray, v_l: FloatArray, lla: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(w_b, f_b), each (N, 3): rate against inertial space and specific force."""
    C_lb = dcms(pose[:, :3])
    lat, _, alt = lla.T
    along, across = _radii(lat)
    zero = np.zeros(len(lat))
    w_ie = EARTH_RATE * np.column_stack([np.cos(lat), zero, -np.sin(lat)])
    east = v_l[:, 1] / (across + alt)
    w_el = np.column_stack([east, -v_l[:, 0] / (along + alt), -east * np.tan(lat)])
    roll, pitch, yaw, speed = pose.T
    d_roll, d_pitch, d_yaw, d_speed = rates.T
    turning = np.column_stack(
        [
            d_roll - np.sin(pitch) * d_yaw,
            np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw,
            -np.sin(roll) * d_pitch + np.cos(roll) * np.cos(pitch) * d_yaw,
        ]
    )
    d_level = d_speed * np.cos(pitch) - speed * np.sin(pitch) * d_pitch
    level = speed * np.cos(pitch)
    a_l = np.column_stack(
        [
            d_level * np.cos(yaw) - level * np.sin(yaw) * d_yaw,
            d_level * np.sin(yaw) + level * np.cos(yaw) * d_yaw,
            -d_speed * np.sin(pitch) - speed * np.cos(pitch) * d_pitch,
        ]
    )
    g = np.array(
        [normal_gravity(math.sin(a), h) for a, h in zip(lat[::200], alt[::200], strict=True)]
    )
    g = np.interp(np.arange(len(lat)), np.arange(0, len(lat), 200), g)
    f_l = a_l + np.cross(2.0 * w_ie + w_el, v_l)
    f_l[:, 2] -= g
    w_b = turning + np.einsum("kji,kj->ki", C_lb, w_ie + w_el)
    return w_b, np.einsum("kji,kj->ki", C_lb, f_l)


def dcms(euler: FloatArray) -> FloatArray:
    """C_lb (N, 3, 3) of Euler angles (N, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(euler).T, np.cos(euler).T
    return np.moveaxis(
        np.array(
            [
                [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
                [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
                [-sp, sr * cp, cr * cp],
            ]
        ),
        2,
        0,
    )


def noisy(way: Way, random: np.random.Generator, lever_b: FloatArray, delay: float) -> Flight:
    """A run of the way with noise of its own: biases, white noise, and GNSS with its Markov noise."""
    count = len(way.increments)
    biases = random.normal(size=6) * np.repeat([GYRO_BIAS, ACCEL_BIAS], 3)
    white = random.normal(size=(count, 6)) * np.repeat([GYRO_NOISE, ACCEL_NOISE], 3)
    increments = way.increments + biases * STEP + white * math.sqrt(STEP)
    at = np.arange(0, count - round(abs(delay) * RATE), RATE) - round(delay * RATE)
    at = at[at >= 0]
    C_lb = dcms(way.euler[at])
    lla, v_l = way.lla[at], way.v_l[at]
    arm = np.einsum("kij,j->ki", C_lb, lever_b)
    swing = np.einsum("kij,kj->ki", C_lb, np.cross(way.w_b[at], lever_b))
    noise = _markov(random, len(at), np.concatenate([POSITION_NOISE, VELOCITY_NOISE]))
    off = arm + noise[:, :3]
    along, across = _radii(lla[:, 0])
    lla = lla + np.column_stack(
        [
            off[:, 0] / (along + lla[:, 2]),
            off[:, 1] / ((across + lla[:, 2]) * np.cos(lla[:, 0])),
            -off[:, 2],
        ]
    )
    tenth = RATE // 10
    return Flight(
        increments,
        lla,
        v_l + swing + noise[:, 3:],
        way.lla[tenth::tenth],
        way.v_l[tenth::tenth],
        way.euler[tenth::tenth],
    )


def _markov(random: np.random.Generator, count: int, sigma: FloatArray) -> FloatArray:
    """A first-order Markov process a second apart (count, len(sigma)) with these 1-sigma."""
    rho = math.exp(-1.0 / NOISE_TIME)
    out = random.normal(size=(count, len(sigma))) * sigma
    for k in range(1, count):
        out[k] = rho * out[k - 1] + math.sqrt(1.0 - rho * rho) * out[k]
    return out
