"""A log as a folder of CSV files: `imu`, and beside it `gnss`, `mag`, `baro`, `heading`, `reference` or `truth`.

Each is `name.csv`, also in .xz or .gz, with the columns of `COLUMNS`: SI units and radians, a suffix where not.
Format: docs/reference/csv_folder.md.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs.csv_table import CsvTable, find_table, read_table
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
    imu, gnss = tables["imu"], tables["gnss"]
    if imu is None:
        raise LogFormatError(f"{folder} holds no imu.csv: nothing to estimate from")
    if not len(imu):
        raise LogFormatError(f"{imu.path} has no IMU samples")
    return SensorLog(
        ImuTable(imu.t_us, imu.stack(*_ACCEL), imu.stack(*_GYRO)),
        [] if gnss is None else _fixes(gnss),
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


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _fixes(table: CsvTable) -> list[GnssFix]:
    place = np.radians(table.stack(*_LLA[:2]))
    alt, velocity = table.column("alt_m"), table.stack(*_VELOCITY)
    quality = table.stack(*_QUALITY)
    fixes = []
    for k, t_us in enumerate(table.t_us.tolist()):
        fix_type, satellites, sigma_h, sigma_v, sigma_speed = quality[k].tolist()
        v_n, v_e, v_d = velocity[k].tolist()
        fixes.append(
            GnssFix(
                t_us,
                float(place[k, 0]),
                float(place[k, 1]),
                float(alt[k]),
                None if math.isnan(v_n) or math.isnan(v_e) else (v_n, v_e, v_d),
                3 if math.isnan(fix_type) else int(fix_type),
                # no satellite has no fix: recorders write 0 for a number that they do not know
                int(satellites) if satellites > 0.0 else None,
                _or_none(sigma_h),
                _or_none(sigma_v),
                _or_none(sigma_speed),
                "gnss.csv",
            )
        )
    return fixes


def _headings(table: CsvTable | None) -> list[HeadingFix]:
    if table is None:
        return []
    rows = zip(
        table.t_us.tolist(),
        table.column("yaw").tolist(),
        table.column("sigma").tolist(),
        strict=True,
    )
    return [HeadingFix(t_us, yaw, _or_none(sigma), "heading.csv") for t_us, yaw, sigma in rows]


def _mags(table: CsvTable | None) -> list[MagSample]:
    if table is None:
        return []
    field = table.stack(*_MAG)
    return [MagSample(t_us, field[k], "mag.csv") for k, t_us in enumerate(table.t_us.tolist())]


def _baros(table: CsvTable | None) -> list[BaroSample]:
    if table is None:
        return []
    rows = zip(table.t_us.tolist(), table.column("alt_m").tolist(), strict=True)
    return [BaroSample(t_us, alt, "baro.csv") for t_us, alt in rows]


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
