"""The square spiral: the original's estimate matched by the Euler-angle filter, its errors beaten by the others.

A record of 400 s on a flat Earth that does not turn: IMU and magnetometer at 10 Hz, GNSS at 1 Hz, the truth, and the
estimate of the original filter. Source: Barton (2012) and the article that published record and filter.
"""

from __future__ import annotations

import dataclasses
import lzma
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading, magnetometer
from mavins.examples.base import Figure, needed
from mavins.filters import (
    REGISTRY,
    Filter,
    FilterSettings,
    FilterState,
    ImuNoise,
    RowBlock,
    make,
)
from mavins.filters.settings import EulerEkfSettings
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CANONICAL_SIZE, X_SIZE
from mavins.nav.so3 import euler_jacobian, euler_to_quat, quat_to_euler, wrap_pi
from mavins.types import FloatArray, IntArray, Origin

RATE: Final = 10.0
"""Samples a second of IMU and magnetometer."""
GNSS_SIGMA: Final = (1.0, 0.05)
FIELD_N: Final = np.array([1.0, 0.0, 0.0])
FIELD_SIGMA: Final = 0.02
HEADING_SIGMA: Final = 0.02
START: Final = np.repeat([100.0, 10.0, math.radians(30.0), 0.01, 0.05], 3)
"""1-sigma of p_n, v_n, attitude and both biases at the start, as in the original."""

ORIGINAL: Final = ImuNoise(0.002, 1e-3, 1e-3, 1e-3)
"""Its process noises, floored at 1e-3 as it does; the first is that of the angles."""
SENSORS: Final = ImuNoise(0.005 / math.sqrt(RATE), 0.02 / math.sqrt(RATE), 1e-6, 1e-5)
"""The noises of the record's sensors as densities; their biases do not move, the walks are there for form's sake.

The accelerometer's is taken twice: it has to cover what a line between samples 0.1 s apart misses, too.
"""

FLAT: Final = Origin(math.radians(49.6), 0.0, 110.0)
"""Where normal gravity is the record's 9.81 m/s^2."""
SETTLED: Final = 60.0
COLUMNS: Final = {
    "north": ("m", 0.495),
    "east": ("m", 0.485),
    "height": ("m", 0.27),
    "v north": ("m/s", 0.043),
    "v east": ("m/s", 0.048),
    "v down": ("m/s", 0.018),
    "roll": ("deg", 0.154),
    "pitch": ("deg", 0.165),
    "yaw": ("deg", 0.228),
}
"""RMS errors after 60 s: unit, and what an error-state filter with the same measurements was found to reach.

Its north and east are known to two digits, .49 and .48; its height was .29, the original's .27.
"""
MATCH: Final = 1e-6
"""The published estimate has ten digits: up to 5e-7 m of a difference is its own rounding."""


@dataclass(frozen=True, slots=True)
class Record:
    """The record in our words: t_us (N,), u (N, 6), field_b (N, 3), yaw (N,), p_n and v_n (N, 3; nan: no fix)."""

    t_us: IntArray
    u: FloatArray
    field_b: FloatArray
    yaw: FloatArray
    p_n: FloatArray
    v_n: FloatArray


@dataclass(frozen=True, slots=True)
class Track:
    """Position, velocity, Euler angles and biases (rad) at the record's instants: (N, 3) each, biases (N, 6)."""

    p_n: FloatArray
    v_n: FloatArray
    euler: FloatArray
    biases: FloatArray


def columns(path: Path) -> dict[str, FloatArray]:
    """The columns of a compressed table by their names."""
    with lzma.open(path, "rt") as file:
        names = file.readline().strip().split(",")
        table = np.genfromtxt(file, delimiter=",")
    return dict(zip(names, table.T, strict=True))


def picked(table: dict[str, FloatArray], *names: str) -> FloatArray:
    """Some columns side by side (N, k)."""
    return np.column_stack([table[name] for name in names])


def read_record(path: Path) -> Record:
    """The sensors; heights become the third component of p_n, unwrapped headings stay as they are."""
    s = columns(path)
    return Record(
        np.round(s["time_s"] * 1e6).astype(np.int64),
        picked(s, "gx_rps", "gy_rps", "gz_rps", "fx_mps2", "fy_mps2", "fz_mps2"),
        picked(s, "mx", "my", "mz"),
        np.radians(s["mag2D_yaw_deg"]),
        picked(s, "gps_north_m", "gps_east_m", "gps_h_msl_m") * [1.0, 1.0, -1.0],
        picked(s, "gps_vn_mps", "gps_ve_mps", "gps_vd_mps"),
    )


def read_original(path: Path) -> Track:
    """The estimate of the original."""
    e = columns(path)
    return Track(
        picked(e, "north_m", "east_m", "alt_m") * [1.0, 1.0, -1.0],
        picked(e, "vn", "ve", "vd"),
        picked(e, "roll_rad", "pitch_rad", "yaw_rad"),
        picked(e, "bgx", "bgy", "bgz", "bax", "bay", "baz"),
    )


def read_truth(path: Path) -> Track:
    """The truth, without the biases, which are not in the table."""
    t = columns(path)
    return Track(
        picked(t, "north_m", "east_m", "h_msl_m") * [1.0, 1.0, -1.0],
        picked(t, "vn_mps", "ve_mps", "vd_mps"),
        np.radians(picked(t, "roll_deg", "pitch_deg", "yaw_deg")),
        np.empty((len(t["time_s"]), 0)),
    )


def still_frame() -> TangentFrame:
    """Frame n of an Earth that does not turn, as in the record."""
    return dataclasses.replace(TangentFrame.at(FLAT), w_ie_n=np.zeros(3))


def flat_heading(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As heading.model where the local level frame is n everywhere."""
    roll, pitch, yaw = quat_to_euler(x[6:10])
    H = np.zeros((1, CANONICAL_SIZE))
    H[0, 6:9] = euler_jacobian(roll, pitch)[2]
    return np.array([wrap_pi(z[0] - yaw)]), H


def fixes(record: Record, k: int) -> list[Measurement]:
    """Position and velocity of sample k, if it has a fix."""
    if math.isnan(record.p_n[k, 0]):
        return []
    t = int(record.t_us[k])
    level = np.concatenate([np.eye(3).ravel(), [0.0, 0.0, 9.81]])
    parts = (
        (gnss_position, record.p_n[k], np.empty(0), GNSS_SIGMA[0]),
        (gnss_velocity, record.v_n[k], level, GNSS_SIGMA[1]),
    )
    return [
        Measurement(
            part.NAME, part.RANK, "gnss", t, t, z, np.eye(3) * sigma**2, other, part.model, math.inf
        )
        for part, z, other, sigma in parts
    ]


def original_heading(record: Record, k: int) -> Measurement:
    """The heading as the original takes it: its noise covariance is sigma, not sigma^2."""
    t, z, R = int(record.t_us[k]), record.yaw[k : k + 1], np.array([[HEADING_SIGMA]])
    none = np.empty(0)
    return Measurement(heading.NAME, heading.RANK, "mag", t, t, z, R, none, flat_heading, math.inf)


def field(record: Record, k: int) -> Measurement:
    """The field of sample k along the body's axes."""
    t = int(record.t_us[k])
    return magnetometer.measure("mag", t, t, record.field_b[k], FIELD_N, FIELD_SIGMA, math.inf)


def run_filter(
    algorithm: Filter,
    record: Record,
    start_us: int,
    direction: Callable[[Record, int], Measurement],
) -> Track:
    """The estimates of a filter after each sample's measurements: the direction's first, then the fix's.

    It starts level at `start_us`, where the first fix and the first heading say.
    """
    frame = still_frame()
    x = np.zeros(X_SIZE)
    x[0:3], x[3:6] = record.p_n[0], record.v_n[0]
    x[6:10] = euler_to_quat(0.0, 0.0, record.yaw[0])
    state = FilterState(x, np.diag(START**2), record.u[0].copy(), start_us)
    algorithm.adopt(state)
    rows = RowBlock.empty(1)
    kept = np.empty((len(record.t_us), X_SIZE))
    for k, t_us in enumerate(record.t_us.tolist()):
        if t_us > state.t_us:
            part = slice(k, k + 1)
            algorithm.walk(
                state, frame, record.t_us[part], record.u[part], t_us, state.t_us, -1, rows
            )
        for measurement in (direction(record, k), *fixes(record, k)):
            algorithm.update(state, measurement, math.inf)
        kept[k] = state.x
    euler = np.array([quat_to_euler(q) for q in kept[:, 6:10]])
    return Track(kept[:, 0:3], kept[:, 3:6], euler, kept[:, 10:16])


def wrapped(angles: FloatArray) -> FloatArray:
    """Angles in [-pi, pi)."""
    return (angles + math.pi) % (2.0 * math.pi) - math.pi


def match(got: Track, original: Track) -> list[Figure]:
    """The largest differences to the original's estimate, over all rows."""
    pairs = {
        "angles": (wrapped(got.euler - original.euler), "rad"),
        "position": (got.p_n - original.p_n, "m"),
        "velocity": (got.v_n - original.v_n, "m/s"),
        "biases": (got.biases - original.biases, "rad/s, m/s^2"),
    }
    return [
        Figure(f"euler_ekf compat minus the original, {name}", float(np.abs(d).max()), MATCH, unit)
        for name, (d, unit) in pairs.items()
    ]


def rms(got: Track, truth: Track, t_us: IntArray) -> FloatArray:
    """RMS errors (9,) after 60 s, in the units of COLUMNS."""
    angles = np.degrees(wrapped(got.euler - truth.euler))
    errors = np.hstack([got.p_n - truth.p_n, got.v_n - truth.v_n, angles])
    late: FloatArray = errors[t_us > SETTLED * 1e6]
    out: FloatArray = np.sqrt(np.mean(late**2, axis=0))
    return out


def run(data: Path | None, out: Path | None, say: Callable[[str], None]) -> Sequence[Figure]:
    """Match the original, then let every filter at the same record with the field's three axes."""
    record = read_record(needed(data, "barton", "sensors_seed1.csv.xz"))
    original = read_original(needed(data, "barton", "octave_estimate_seed1.csv.xz"))
    truth = read_truth(needed(data, "barton", "truth.csv.xz"))
    say("square spiral: 400 s, IMU and magnetometer 10 Hz, GNSS 1 Hz")
    compat = FilterSettings(euler_ekf=EulerEkfSettings(compat=True))
    euler = make("euler_ekf", ORIGINAL, settings=compat)
    # the original moves over an interval before its first sample, too
    first_us = round(-1e6 / RATE)
    figures = match(run_filter(euler, record, first_us, original_heading), original)
    table = {"original": rms(original, truth, record.t_us)}
    for name in REGISTRY:
        algorithm = make(name, SENSORS)
        table[name] = rms(run_filter(algorithm, record, 0, field), truth, record.t_us)
        if name != "euler_ekf":
            figures += [
                Figure(f"{name} {column}", float(value), limit, unit)
                for value, (column, (unit, limit)) in zip(table[name], COLUMNS.items(), strict=True)
            ]
    lines = list(lines_of(table))
    for line in lines:
        say(line)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "square-spiral.txt").write_text("\n".join(lines) + "\n")
    return figures


def lines_of(table: dict[str, FloatArray]) -> Sequence[str]:
    """The RMS errors as a table of text."""
    head = "".join(f"{name:>9}" for name in COLUMNS)
    units = "".join(f"{unit:>9}" for unit, _ in COLUMNS.values())
    rows = [f"{name:<12}" + "".join(f"{v:9.3f}" for v in values) for name, values in table.items()]
    return [f"{'RMS > 60 s':<12}{head}", f"{'':<12}{units}", *rows]
