"""A log as a folder of CSV files: `imu`, and beside it `gnss`, `mag`, `baro`, `heading`, `reference` or `truth`.

Each is `name.csv`, also in .xz or .gz, with the columns of `COLUMNS`: SI units and radians, a suffix where not.
Format: docs/reference/csv_folder.md.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs import readings
from mavins.logs.csv_table import CsvTable, find_table, read_table
from mavins.logs.readings import Readings
from mavins.logs.sensor_log import DEFAULT, Choice, SensorLog
from mavins.logs.truth import Truth
from mavins.nav.rotations import euler_to_quats
from mavins.types import BaroSample, GnssFix, HeadingFix, ImuTable, MagSample

_LLA: Final = ("lat_deg", "lon_deg", "alt_m")
_VELOCITY: Final = ("vel_n", "vel_e", "vel_d")
_QUALITY: Final = ("fix_type", "satellites", "sigma_h", "sigma_v", "sigma_speed")
_ACCEL: Final = ("accel_x", "accel_y", "accel_z")
_GYRO: Final = ("gyro_x", "gyro_y", "gyro_z")
_MAG: Final = ("mag_x", "mag_y", "mag_z")
_EULER: Final = ("roll", "pitch", "yaw")

COLUMNS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "imu": ((*_ACCEL, *_GYRO), ()),
    "gnss": (_LLA, (*_VELOCITY, *_QUALITY)),
    "mag": (_MAG, ()),
    "baro": (("alt_m",), ()),
    "heading": (("yaw",), ("sigma",)),
    "truth": ((), (*_LLA, *_VELOCITY, *_EULER)),
    "reference": ((), (*_LLA, *_VELOCITY, *_EULER)),
}
"""Table -> (needed, optional) columns, beside the stamp `t_us` in microseconds."""


def read_csv_folder(folder: Path, choice: Choice = DEFAULT) -> SensorLog:
    """Read all tables of a folder; LogFormatError where there is no IMU, or one is damaged."""
    dropped: Counter[str] = Counter()
    tables = {name: _table(folder, name, dropped) for name in COLUMNS}
    imu = tables["imu"]
    if imu is None:
        raise LogFormatError(f"{folder} holds no imu.csv: nothing to estimate from")
    if not len(imu):
        raise LogFormatError(f"{imu.path} has no IMU samples")
    return SensorLog(
        ImuTable(imu.t_us, imu.stack(*_ACCEL), imu.stack(*_GYRO)),
        _fixes(tables["gnss"]),
        _headings(tables["heading"]),
        _mags(tables["mag"]),
        _baros(tables["baro"]),
        _truth(tables["truth"]),
        _truth(tables["reference"]),
        {name: f"{name}.csv" for name, table in tables.items() if table is not None},
        dropped,
        {},
    )


def _table(folder: Path, name: str, dropped: Counter[str]) -> CsvTable | None:
    """The rows of a table in which everything needed is given."""
    path = find_table(folder, name)
    if path is None:
        return None
    needed, optional = COLUMNS[name]
    table = read_table(path, needed, optional)
    if not needed:
        return table
    values = table.stack(*needed)
    usable = ~np.isnan(values).any(axis=1)
    dropped[f"{name} not given"] += int((~usable).sum())
    if name in ("imu", "mag"):
        # recorders write zeros until a sensor has spoken
        silent = (values == 0.0).all(axis=1)
        dropped[f"{name} all zero"] += int(silent.sum())
        usable &= ~silent
    return table.select(np.flatnonzero(usable))


def _fixes(table: CsvTable | None) -> Readings[GnssFix]:
    if table is None:
        return readings.NO_FIXES
    place = np.column_stack([np.radians(table.stack(*_LLA[:2])), table.column("alt_m")])
    quality = table.stack(*_QUALITY)
    fix_type, satellites = quality[:, 0], quality[:, 1]
    fix_type[np.isnan(fix_type)] = 3.0
    # no satellite has no fix: recorders write 0 for a number that they do not know
    satellites[satellites <= 0.0] = np.nan
    velocity = table.stack(*_VELOCITY)
    return readings.fixes(table.t_us, place, velocity, quality[:, :2], quality[:, 2:], "gnss.csv")


def _headings(table: CsvTable | None) -> Readings[HeadingFix]:
    if table is None:
        return readings.NO_HEADINGS
    yaw, sigma = table.column("yaw"), table.column("sigma")
    return readings.headings(table.t_us, yaw, sigma, "heading.csv")


def _mags(table: CsvTable | None) -> Readings[MagSample]:
    if table is None:
        return readings.NO_FIELDS
    return readings.fields(table.t_us, table.stack(*_MAG), "mag.csv")


def _baros(table: CsvTable | None) -> Readings[BaroSample]:
    if table is None:
        return readings.NO_LEVELS
    return readings.levels(table.t_us, table.column("alt_m"), "baro.csv")


def _truth(table: CsvTable | None) -> Truth | None:
    """A truth, or what the log's own filter said, with NaN where it says nothing; one row per stamp."""
    if table is None:
        return None
    table = table.select(np.unique(table.t_us, return_index=True)[1])
    euler = table.stack(*_EULER)
    q_lb = euler_to_quats(euler)
    lat, lon = np.radians(table.stack(*_LLA[:2])).T
    source = table.path.name.partition(".")[0] + ".csv"
    lla = np.column_stack([lat, lon, table.column("alt_m")])
    return Truth(table.t_us, lla, table.stack(*_VELOCITY), q_lb, source)
