"""KF-GINS text files: IMU increments, GNSS positions and a truth, on the seconds of the GNSS week.

    IMU    7 columns: s, angle increments xyz (rad), velocity increments xyz (m/s), body axes forward, right, down
    GNSS   7 columns: s, latitude, longitude (deg), height (m), sigmas north, east, down (m);
           10 or 13 columns: and velocity north, east, down (m/s), and its sigmas
    truth 11 columns: week, s, latitude, longitude (deg), height (m), velocity NED (m/s), roll, pitch, yaw (deg)

Which file is which is told by what is in it. Heights are above the ellipsoid, and so are the estimates made of them.
Source of the formats: the README of i2Nav-WHU/KF-GINS.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs import readings
from mavins.logs.cleaning import Cleaner
from mavins.logs.number_text import head_of, read_numbers
from mavins.logs.readings import Readings
from mavins.logs.sensor_log import DEFAULT, Choice, SensorLog, chosen
from mavins.logs.truth import Truth
from mavins.mavlink.codec.checks import MAX_ACCEL, MAX_ALTITUDE, MAX_GYRO, MAX_SPEED
from mavins.nav.rotations import euler_to_quats
from mavins.types import FloatArray, GnssFix, ImuTable, IntArray

_WEEK_US: Final = 604_800_000_000
_LONGEST: Final = 0.1
"""s: sensors that are read less often are no IMU."""
_PULL: Final = (3.0, 30.0)
"""m/s^2: the median specific force of a vehicle on Earth lies in between."""
_RTK_SIGMA: Final = 0.1
"""m: only a fix with carrier phases is as good as that."""
_RTK_FIXED: Final = 6
_PLAIN_FIX: Final = 3


def read_kf_gins(path: Path, choice: Choice = DEFAULT) -> SensorLog:
    """Read a folder, or an IMU file with what lies beside it; LogFormatError where there is no IMU."""
    folder = path if path.is_dir() else path.parent
    files: dict[str, list[str]] = {"imu": [], "gnss": [], "truth": []}
    for file in sorted(folder.iterdir()):
        what = role_of(file) if file.is_file() else None
        if what is not None:
            files[what].append(file.name)
    if path.name in files["imu"]:
        usual = path.name
    elif files["imu"] and path.is_dir():
        usual = files["imu"][0]
    else:
        raise LogFormatError(f"{path} holds no IMU increments: nothing to estimate from")
    clean, damage = Cleaner(), Counter[str]()

    def table(name: str) -> FloatArray:
        text = read_numbers(folder / name)
        damage["bad_lines"] += text.bad_lines
        return text.rows

    names = {"imu": chosen("IMU", choice.imu, files["imu"], usual)}
    imu = _imu(table(names["imu"]), clean)
    gnss = readings.NO_FIXES
    truth = None
    if files["gnss"] or choice.gnss:
        names["gnss"] = chosen("GNSS", choice.gnss, files["gnss"], next(iter(files["gnss"]), ""))
        gnss = _fixes(table(names["gnss"]), names["gnss"], clean)
    if files["truth"] or choice.reference:
        name = chosen("truth", choice.reference, files["truth"], next(iter(files["truth"]), ""))
        truth = _truth(table(name), name, clean)
        names["truth"] = name
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
        choices={"imu": files["imu"], "gnss": files["gnss"], "reference": files["truth"]},
        about="KF-GINS text; heights are above the ellipsoid",
    )


def role_of(file: Path) -> str | None:
    """What a text file is: imu, gnss or truth; None for anything else."""
    head = head_of(file)
    if head is None or len(head) < 2:
        return None
    columns = head.shape[1]
    if columns == 11 and np.ptp(head[:, 0]) <= 1.0 and (head[:, 0] % 1.0 == 0.0).all():
        return "truth" if _are_places(head[:, 2:4]) else None
    step = float(np.median(np.diff(head[:, 0])))
    if step <= 0.0:
        return None
    if columns == 7 and step <= _LONGEST:
        pull = float(np.median(np.linalg.norm(head[:, 4:7], axis=1))) / step
        if _PULL[0] < pull < _PULL[1]:
            return "imu"
    if columns in (7, 10, 13) and _are_places(head[:, 1:3]) and (head[:, 4:7] > 0.0).all():
        return "gnss" if step >= 2e-2 else None
    return None


def _are_places(deg: FloatArray) -> bool:
    """True for latitudes and longitudes in deg of one vehicle."""
    return bool((abs(deg) <= (90.0, 180.0)).all() and (np.ptp(deg, axis=0) < 1.0).all())


def _stamps(seconds: FloatArray) -> IntArray:
    """Microseconds, going on where a week ends."""
    stamps: IntArray = np.rint(np.nan_to_num(seconds, posinf=0.0, neginf=0.0) * 1e6).astype(
        np.int64
    )
    ends = np.diff(stamps, prepend=stamps[:1]) < -_WEEK_US // 2
    return stamps + np.cumsum(ends) * _WEEK_US


def _imu(rows: FloatArray, clean: Cleaner) -> ImuTable:
    """Mean rates at the middle of the intervals, each of which ends at its stamp."""
    t_us = _stamps(rows[:, 0])
    kept = clean.rows("imu", t_us, np.isfinite(rows).all(axis=1))
    t_us, rows = t_us[kept], rows[kept]
    if len(t_us) < 2:
        raise LogFormatError("the IMU file has no two samples: nothing to estimate from")
    steps = np.diff(t_us)
    usual = int(np.median(steps))
    # after a gap an increment is still one interval's
    dt_us = np.where(steps > 1.5 * usual, usual, steps)
    dt_us = np.concatenate([[usual], dt_us])
    dt = (dt_us * 1e-6)[:, None]
    gyro, accel = rows[:, 1:4] / dt, rows[:, 4:7] / dt
    sound = (abs(gyro) <= MAX_GYRO).all(axis=1) & (abs(accel) <= MAX_ACCEL).all(axis=1)
    clean.dropped["imu unusable"] += int((~sound).sum())
    return ImuTable((t_us - dt_us // 2)[sound], accel[sound], gyro[sound])


def _fixes(rows: FloatArray, name: str, clean: Cleaner) -> Readings[GnssFix]:
    t_us = _stamps(rows[:, 0])
    usable = np.isfinite(rows).all(axis=1) & (abs(rows[:, 1:3]) <= (90.0, 180.0)).all(axis=1)
    usable &= abs(rows[:, 3]) <= MAX_ALTITUDE
    kept = clean.rows("gnss", t_us, usable)
    t_us, rows = t_us[kept], rows[kept]
    unknown = np.full((len(rows), 3), np.nan)
    sigma_h = np.hypot(rows[:, 4], rows[:, 5]) / np.sqrt(2.0)
    velocity, sigma_speed = unknown, unknown[:, 0]
    if rows.shape[1] >= 10:
        velocity = rows[:, 7:10].copy()
        velocity[(abs(velocity) > MAX_SPEED).any(axis=1)] = np.nan
    if rows.shape[1] == 13:
        sigma_speed = np.linalg.norm(rows[:, 10:13], axis=1) / np.sqrt(3.0)
    return readings.fixes(
        t_us,
        np.column_stack([np.radians(rows[:, 1:3]), rows[:, 3]]),
        velocity,
        np.column_stack([np.where(sigma_h < _RTK_SIGMA, _RTK_FIXED, _PLAIN_FIX), unknown[:, 0]]),
        np.column_stack([sigma_h, rows[:, 6], sigma_speed]),
        name,
    )


def _truth(rows: FloatArray, name: str, clean: Cleaner) -> Truth:
    t_us = _stamps(rows[:, 1])
    rows = rows[(kept := clean.rows("truth", t_us, np.isfinite(rows).all(axis=1)))]
    q_lb = euler_to_quats(np.radians(rows[:, 8:11]))
    lla = np.column_stack([np.radians(rows[:, 2:4]), rows[:, 4]])
    return Truth(t_us[kept], lla, rows[:, 5:8], q_lb.reshape(-1, 4), name)
