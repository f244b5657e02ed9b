"""What estimates are judged by: the simulator's truth, and what the vehicle's own filter said.

ArduPilot turns metres into degrees on a sphere of its own (a radius of 6378100 m, the cosine of the mean latitude); its
positions north and east of an origin are turned back in the same way, which is what its GNSS and its own track are.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mavins.logs.dataflash.channels import Channel, Reading
from mavins.logs.truth import Truth
from mavins.nav.rotations import euler_to_quats
from mavins.types import FloatArray, IntArray

_SPHERE: Final = 6378100.0
_EULER: Final = ("Roll", "Pitch", "Yaw")
_QUATERNION: Final = ("[Q1]", "[Q2]", "[Q3]", "[Q4]")
_LIMIT: Final = 1e7
"""Nothing that is said here is greater, in metres, m/s or degrees."""


def _moderate(rows: FloatArray) -> FloatArray:
    return np.where(abs(rows) < _LIMIT, rows, np.nan)


_FILTER: Final = Reading((*_EULER, "VN", "VE", "VD", "PN", "PE", "PD"), _moderate)
_ATTITUDE: Final = Reading(_EULER, _moderate)

_APART: Final = 0.05
_STEP: Final = 0.005
"""SIM and SIM2 contradict each other if they differ by more than so many m, and m per m/s."""

SIM: Final = {"SIM": Reading((*_EULER, "Lat", "Lng", "Alt", *_QUATERNION), _moderate)}
SIM2: Final = {"SIM2": Reading(("PN", "PE", "PD", "VN", "VE", "VD"), _moderate)}
REFERENCES: Final = {
    "XKF1": _FILTER,
    "NKF1": _FILTER,
    "EKF1": _FILTER,
    "POS": Reading(("Lat", "Lng", "Alt"), _moderate),
    "AHR2": Reading((*_EULER, "Lat", "Lng", "Alt"), _moderate),
    "ATT": _ATTITUDE,
}
ATTITUDE: Final = {"ATT": _ATTITUDE}
ORIGIN: Final = {"ORGN": Reading(("Lat", "Lng", "Alt"), _moderate)}
PERIOD_US: Final = 50_000
"""Of what a judge says more often than that the first is kept: between two positions there is a cubic."""
_BLOCK: Final = 50_000


def truth_of(sim: Channel, sim2: Channel) -> Truth | None:
    """SIM has position and attitude at 10 Hz, SIM2 position and velocity at the loop's rate, from an unnamed home."""
    t_us, rows = sim.table.release()
    if not len(t_us):
        return None
    lla = np.column_stack([np.radians(rows[:, 3:5]), rows[:, 5]])
    told = np.isfinite(rows[:, 6:].sum(axis=1))[:, None]
    q_lb = np.where(told, rows[:, 6:], _quat(rows))
    norm: FloatArray = np.linalg.norm(q_lb, axis=1)
    usable = np.flatnonzero(np.abs(norm - 1.0) < 0.1)
    t_us, lla, q_lb = t_us[usable], lla[usable], q_lb[usable] / norm[usable, None]
    if not len(t_us):
        return None
    if len(sim2) < 2:
        return Truth(t_us, lla, np.full((len(t_us), 3), np.nan), q_lb, str(sim.source))
    at_us, moves = sim2.table.release()
    home, apart = _home(t_us, lla, at_us, moves[:, :3])
    turned = np.empty((len(at_us), 4))
    # in place and in blocks, for this is the largest table after the IMU's
    _forget_contradicted(moves, at_us, t_us, apart)
    for k in range(0, len(at_us), _BLOCK):
        block = slice(k, k + _BLOCK)
        turned[block] = _between(at_us[block], t_us, q_lb)
        moves[block, :3] = _lla(home, moves[block, :3])
    return Truth(at_us, moves[:, :3], moves[:, 3:], turned, f"{sim2.source}, {sim.source}")


def reference_of(channel: Channel, attitude: Channel, origin: Channel) -> Truth | None:
    """What the vehicle's own filter said; nan what that source does not say."""
    t_us, rows = channel.table.release()
    if channel.source is None or not len(t_us):
        return None
    name = str(channel.source)
    nothing = np.full((len(t_us), 3), np.nan)
    match channel.source.message:
        case "POS":
            att_us, angles = attitude.table.release()
            q_lb = (
                _between(t_us, att_us, _quat(angles))
                if len(att_us)
                else np.full((len(t_us), 4), np.nan)
            )
            lla = np.column_stack([np.radians(rows[:, :2]), rows[:, 2]])
            return Truth(t_us, lla, nothing, q_lb, f"{name}, ATT" if len(att_us) else name)
        case "AHR2":
            lla = np.column_stack([np.radians(rows[:, 3:5]), rows[:, 5]])
            lla[(rows[:, 3] == 0.0) & (rows[:, 4] == 0.0)] = np.nan
            return Truth(t_us, lla, nothing, _quat(rows), name)
        case "ATT":
            return Truth(t_us, nothing, nothing, _quat(rows), name)
        case _:
            lla = _from_origin(t_us, rows[:, 6:], origin)
            return Truth(t_us, lla, rows[:, 3:6], _quat(rows), name)


def _from_origin(t_us: IntArray, ned: FloatArray, origin: Channel) -> FloatArray:
    """Latitude, longitude, altitude of positions (N, 3) from the filter's origin, nan before it has one."""
    lla = np.full((len(t_us), 3), np.nan)
    if len(origin):
        lat, lon, alt = origin.table.rows[0].tolist()
        since = t_us >= origin.table.t_us[0]
        lla[since] = _lla(np.array([np.radians(lat), np.radians(lon), alt]), ned[since])
    return lla


def _lla(home: FloatArray, ned: FloatArray) -> FloatArray:
    """Latitude, longitude, altitude (N, 3) of positions (N, 3) in m from a home."""
    north = ned[:, 0] / _SPHERE
    east = ned[:, 1] / (_SPHERE * np.cos(home[0] + 0.5 * north))
    return np.column_stack([home[0] + north, home[1] + east, home[2] - ned[:, 2]])


def _forget_contradicted(
    moves: FloatArray, at_us: IntArray, t_us: IntArray, apart: FloatArray
) -> None:
    """Positions and velocities (M, 6) at `at_us` <- nan where SIM says another position beside them.

    `apart` (N,) is how far in m the two are at `t_us`; the stamps of both are off by up to a step.
    """
    k = np.clip(np.searchsorted(t_us, at_us), 1, max(len(t_us) - 1, 1))
    worst = np.maximum(apart[k - 1], apart[np.minimum(k, len(t_us) - 1)])
    speed = np.linalg.norm(moves[:, 3:], axis=1)
    moves[worst > _APART + _STEP * speed] = np.nan


def _home(
    t_us: IntArray, lla: FloatArray, at_us: IntArray, ned: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where positions (M, 3) at `at_us` count from: the median of what those (N, 3) at `t_us` say; and how far in m
    each of them (N,) is from that."""
    moved = np.column_stack([np.interp(t_us, at_us, ned[:, k]) for k in range(3)])
    backwards = _lla(np.zeros(3), moved)
    east = moved[:, 1] / (_SPHERE * np.cos(lla[:, 0] - 0.5 * backwards[:, 0]))
    homes = np.column_stack(
        [lla[:, 0] - backwards[:, 0], lla[:, 1] - east, lla[:, 2] + moved[:, 2]]
    )
    home: FloatArray = np.median(homes, axis=0)
    off = (homes - home) * (_SPHERE, _SPHERE * np.cos(home[0]), 1.0)
    apart: FloatArray = np.linalg.norm(off, axis=1)
    return home, apart


def _quat(euler: FloatArray) -> FloatArray:
    """Unit quaternions (N, 4) of roll, pitch, yaw in degrees (N, 3 or more)."""
    return euler_to_quats(np.radians(euler[:, :3]))


def _between(at_us: IntArray, t_us: IntArray, q: FloatArray) -> FloatArray:
    """Attitudes at instants (M, 4) on normalized chords between those at `t_us` (N, 4), nan outside."""
    if len(t_us) < 2:
        return np.full((len(at_us), 4), np.nan)
    k = np.clip(np.searchsorted(t_us, at_us, side="right") - 1, 0, len(t_us) - 2)
    s = ((at_us - t_us[k]) / (t_us[k + 1] - t_us[k]))[:, None]
    flip = np.where(np.sum(q[k] * q[k + 1], axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    chord = q[k] + s * (flip * q[k + 1] - q[k])
    chord[(s[:, 0] < 0.0) | (s[:, 0] > 1.0)] = np.nan
    unit: FloatArray = chord / np.linalg.norm(chord, axis=1, keepdims=True)
    return unit
