"""Folders in the manner of the EuRoC MAV dataset: `mav0/imu0/data.csv` and beside it a ground truth and GNSS.

    imu0                          ns, angular rate xyz (rad/s), specific force xyz (m/s^2)
    state_groundtruth_estimate0   ns, position xyz (m), quaternion wxyz, velocity xyz (m/s), ...
    gps0 or gnss0 (our addition)  ns, latitude, longitude (deg), altitude (m), optionally velocity NED (m/s)

The sensor's axes are taken as forward, left, up, the ground truth's world as east, north, up; it has no place on Earth,
so positions are not judged. Source of the formats: Burri et al., "The EuRoC micro aerial vehicle datasets" (2016).
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs import readings
from mavins.logs.cleaning import Cleaner
from mavins.logs.csv_table import find_table
from mavins.logs.number_text import read_numbers
from mavins.logs.readings import Readings
from mavins.logs.sensor_log import DEFAULT, Choice, SensorLog, chosen
from mavins.logs.truth import Truth
from mavins.mavlink.codec.checks import MAX_ACCEL, MAX_ALTITUDE, MAX_GYRO, MAX_SPEED
from mavins.nav.so3 import quat_mul
from mavins.types import FloatArray, GnssFix, ImuTable, IntArray

_FLIP: Final = np.array([1.0, -1.0, -1.0])
"""Forward, left, up to forward, right, down."""
_Q_FLIP: Final = np.array([0.0, 1.0, 0.0, 0.0])
_Q_NED_ENU: Final = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
_WIDTHS: Final = {"imu": 7, "gps": 4, "gnss": 4, "state_groundtruth_estimate": 11}


def root_of(folder: Path) -> Path | None:
    """The folder in which imu0 lies: this one or mav0 in it; None where there is none."""
    for root in (folder, folder / "mav0"):
        if find_table(root / "imu0", "data") is not None:
            return root
    return None


def read_euroc(folder: Path, choice: Choice = DEFAULT) -> SensorLog:
    """Read a folder; LogFormatError where it has no IMU."""
    root = root_of(folder)
    if root is None:
        raise LogFormatError(f"{folder} holds no imu0/data.csv: nothing to estimate from")
    clean, damage = Cleaner(), Counter[str]()

    def table(sensor: str) -> FloatArray:
        path = find_table(root / sensor, "data")
        assert path is not None  # it was found
        text = read_numbers(path)
        if text.rows.shape[1] < _WIDTHS[sensor.rstrip("0123456789")]:
            raise LogFormatError(f"{path} has {text.rows.shape[1]} columns: too few")
        damage["bad_lines"] += text.bad_lines
        return text.rows

    imus, receivers = _sensors(root, "imu"), [*_sensors(root, "gps"), *_sensors(root, "gnss")]
    truths = _sensors(root, "state_groundtruth_estimate")
    names = {"imu": chosen("IMU", choice.imu, imus, imus[0])}
    imu = _imu(table(names["imu"]), clean)
    gnss = readings.NO_FIXES
    truth = None
    if receivers or choice.gnss:
        names["gnss"] = chosen("GNSS", choice.gnss, receivers, next(iter(receivers), ""))
        gnss = _fixes(table(names["gnss"]), names["gnss"], clean)
    if truths or choice.reference:
        names["truth"] = chosen("truth", choice.reference, truths, next(iter(truths), ""))
        truth = _truth(table(names["truth"]), names["truth"], clean)
    damage.update(clean.disorder)
    return SensorLog(
        imu,
        gnss,
        readings.NO_HEADINGS,
        readings.NO_FIELDS,
        readings.NO_LEVELS,
        truth,
        None,
        names,
        clean.dropped,
        {k: v for k, v in damage.items() if v},
        choices={"imu": imus, "gnss": receivers, "reference": truths},
        about="EuRoC-style folder; axes forward, left, up",
    )


def _sensors(root: Path, kind: str) -> list[str]:
    """The folders of a kind of sensor."""
    return sorted(
        path.name for path in root.glob(f"{kind}[0-9]*") if find_table(path, "data") is not None
    )


def _stamps(rows: FloatArray) -> IntArray:
    """us; doubles hold stamps of ns since 1970 to a quarter of one."""
    stamps: IntArray = np.rint(np.nan_to_num(rows[:, 0], posinf=0.0, neginf=0.0) * 1e-3).astype(
        np.int64
    )
    return stamps


def _imu(rows: FloatArray, clean: Cleaner) -> ImuTable:
    t_us, gyro, accel = _stamps(rows), rows[:, 1:4] * _FLIP, rows[:, 4:7] * _FLIP
    usable = (abs(gyro) <= MAX_GYRO).all(axis=1) & (abs(accel) <= MAX_ACCEL).all(axis=1)
    kept = clean.rows("imu", t_us, usable)
    if not len(kept):
        raise LogFormatError("the IMU has no samples: nothing to estimate from")
    return ImuTable(t_us[kept], accel[kept], gyro[kept])


def _fixes(rows: FloatArray, name: str, clean: Cleaner) -> Readings[GnssFix]:
    t_us = _stamps(rows)
    usable = (abs(rows[:, 1:3]) <= (90.0, 180.0)).all(axis=1) & (abs(rows[:, 3]) <= MAX_ALTITUDE)
    kept = clean.rows("gnss", t_us, usable)
    t_us, rows = t_us[kept], rows[kept]
    velocity = rows[:, 4:7].copy() if rows.shape[1] >= 7 else np.full((len(rows), 3), np.nan)
    velocity[(abs(velocity) > MAX_SPEED).any(axis=1)] = np.nan
    place = np.column_stack([np.radians(rows[:, 1:3]), rows[:, 3]])
    quality = np.tile([3.0, np.nan], (len(rows), 1))
    return readings.fixes(t_us, place, velocity, quality, np.full((len(rows), 3), np.nan), name)


def _truth(rows: FloatArray, name: str, clean: Cleaner) -> Truth:
    """Attitude and velocity, turned from east, north, up and forward, left, up into our axes."""
    t_us = _stamps(rows)
    norm = np.linalg.norm(rows[:, 4:8], axis=1)
    usable = np.isfinite(rows[:, 4:11]).all(axis=1) & (abs(norm - 1.0) < 0.1)
    kept = clean.rows("truth", t_us, usable)
    q_rs = rows[kept, 4:8] / norm[kept, None]
    q_lb = np.array([quat_mul(quat_mul(_Q_NED_ENU, q), _Q_FLIP) for q in q_rs]).reshape(-1, 4)
    v_l = rows[kept][:, [9, 8, 10]] * [1.0, 1.0, -1.0]
    return Truth(t_us[kept], np.full((len(kept), 3), np.nan), v_l, q_lb, name)
