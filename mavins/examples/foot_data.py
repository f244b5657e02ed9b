"""Recordings of an IMU on a foot, turned into what the filters take: rows [gyro_b, accel_b], forward-right-down, SI."""

from __future__ import annotations

import lzma
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mavins.errors import LogFormatError
from mavins.types import FloatArray, IntArray

_FIELDS = 17
_STANDARD_GRAVITY = 9.80665
_TO_DOWN = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True)
class Recording:
    """One walk: stamps `t_us` (N,), readings `imu` (N, 6) and, where known, the true track `truth` (N, 2) in m."""

    name: str
    t_us: IntArray
    imu: FloatArray
    truth: FloatArray | None = None


def read_openshoe(path: Path) -> Recording:
    """A closed loop of OpenShoe: text, specific force in g, axes forward-left-up.

    The stamps are taken by the host and jitter by up to 20 ms, but no sample is missing: the times lie on the line
    through the stamps over the samples' numbers.
    """
    try:
        with lzma.open(path, "rt") as file:
            split = [line.split() for line in file]
    except (lzma.LZMAError, EOFError, UnicodeDecodeError) as error:
        raise LogFormatError(f"{path}: {error}") from None
    wanted = [parts for parts in split if len(parts) == _FIELDS and parts[0] == "0xcb"]
    if len(wanted) < 2:
        raise LogFormatError(f"{path}: no samples of 17 fields that begin with 0xcb")
    # the fields after the counter: a checksum in hexadecimal, the sample's number, the host's time
    columns = [*range(1, 7), 9, 10]
    try:
        values = np.array([[float(parts[i]) for i in columns] for parts in wanted])
    except ValueError as error:
        raise LogFormatError(f"{path}: {error}") from None
    number = values[:, 6] - values[0, 6]
    slope, start = np.polyfit(number, values[:, 7] - values[0, 7], 1)
    t_us = np.round((start + slope * number) * 1e6).astype(np.int64)
    gyro = values[:, 3:6] * _TO_DOWN
    accel = values[:, 0:3] * _TO_DOWN * _STANDARD_GRAVITY
    return Recording(path.name.split(".")[0], t_us - t_us[0], np.hstack([gyro, accel]))


def read_vicon(path: Path) -> Recording:
    """A trial before motion-capture cameras: SI, forward-right-down, with the true horizontal track."""
    try:
        with np.load(path) as content:
            t, imu, truth = (np.asarray(content[key], dtype=float) for key in ("t", "imu", "gt"))
    except (KeyError, ValueError, OSError) as error:
        raise LogFormatError(f"{path}: {error}") from None
    t_us = np.round((t.ravel() - t.flat[0]) * 1e6).astype(np.int64)
    return Recording(path.stem, t_us, np.hstack([imu[:, 3:], imu[:, :3]]), truth)
