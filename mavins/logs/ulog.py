"""PX4's .ulg logs as tables of sensors.

The axes of PX4's body are ours, its stamps are microseconds since boot, its altitudes above mean sea level. An IMU
message holds means or increments over the interval that ends at its stamp: they become samples at the middle of it.
The topics read, and what stands for what: docs/reference/logs.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs import readings
from mavins.logs.cleaning import Cleaner, thinned
from mavins.logs.packed import fault_of, open_packed
from mavins.logs.readings import Readings
from mavins.logs.sensor_log import DEFAULT, Choice, SensorLog, chosen
from mavins.logs.truth import Truth
from mavins.logs.ulog_file import Rows, Topic, UlogFile, scan
from mavins.mavlink.codec.checks import MAX_ACCEL, MAX_ALTITUDE, MAX_GYRO, MAX_SPEED
from mavins.types import BaroSample, FloatArray, GnssFix, ImuTable, IntArray, MagSample

_STAMPS: Final = ("timestamp", "timestamp_sample")
_ATTITUDE: Final = (*_STAMPS, "q")
_LOCAL: Final = (*_STAMPS, "vx", "vy", "vz", "v_xy_valid", "v_z_valid")
_GLOBAL: Final = (*_STAMPS, "lat", "lon", "alt")
_GPS: Final = (
    *_STAMPS,
    *("latitude_deg", "longitude_deg", "altitude_msl_m", "lat", "lon", "alt"),
    *("vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "vel_ned_valid"),
    *("eph", "epv", "s_variance_m_s", "fix_type", "satellites_used"),
)
_WANTED: Final = {
    "sensor_combined": (
        *("timestamp", "gyro_rad", "gyro_integral_dt", "accelerometer_m_s2"),
        "accelerometer_clipping",
    ),
    "vehicle_imu": (
        *_STAMPS,
        *("delta_angle", "delta_velocity", "delta_angle_dt", "delta_velocity_dt"),
        "delta_velocity_clipping",
    ),
    "vehicle_gps_position": _GPS,
    "sensor_gps": _GPS,
    "vehicle_magnetometer": (*_STAMPS, "magnetometer_ga"),
    "sensor_mag": (*_STAMPS, "x", "y", "z"),
    "vehicle_air_data": (*_STAMPS, "baro_alt_meter"),
    **{
        prefix + what + suffix: fields
        for prefix, suffix in (("vehicle_", ""), ("estimator_", ""), ("vehicle_", "_groundtruth"))
        for what, fields in (
            ("attitude", _ATTITUDE),
            ("local_position", _LOCAL),
            ("global_position", _GLOBAL),
        )
    },
}
_IMUS: Final = ("sensor_combined", "vehicle_imu")
_RECEIVERS: Final = ("vehicle_gps_position", "sensor_gps")
_WORTH: Final = 0.67
"""What the vehicle itself chose is taken where it has this share of the rows that another source has."""
_GAP: Final = 0.5
"""A reference is given only between two messages less than so many s apart."""


def read_ulog(path: Path, choice: Choice = DEFAULT) -> SensorLog:
    """Read a .ulg, also packed; LogFormatError where it is none, or has no IMU."""
    with open_packed(path) as stream:
        try:
            file = scan(stream, _WANTED)
        except LogFormatError as error:
            raise LogFormatError(f"{path} is {error}") from error
        fault = fault_of(stream)
    clean = Cleaner()
    imus, receivers = _sources(file, _IMUS), _sources(file, _RECEIVERS)
    if not imus:
        raise LogFormatError(
            f"{path} has no IMU (sensor_combined, vehicle_imu): nothing to estimate from"
        )
    imu = chosen("IMU", choice.imu, list(imus), _usual(file, imus))
    table = _imu(imus[imu][0], file.topics[imus[imu]], clean)
    names, gnss, delay = {"imu": imu}, readings.NO_FIXES, None
    if receivers or choice.gnss:
        names["gnss"] = chosen(
            "GNSS", choice.gnss, list(receivers), _usual(file, receivers) if receivers else ""
        )
        topic = receivers[names["gnss"]]
        gnss, delay = _fixes(file, topic, names["gnss"], clean)
    mag = _mags(file, names, clean)
    baro = _baros(file, names, clean)
    references = _references(file)
    reference = None
    if references or choice.reference:
        name = chosen("reference", choice.reference, list(references), next(iter(references), ""))
        reference = _truth(file, *references[name], name, clean)
    truth = _truth(file, "vehicle_", "_groundtruth", 0, "groundtruth", clean)
    names |= {k: v.source for k, v in (("truth", truth), ("reference", reference)) if v}
    damage = {
        "skipped_bytes": file.skipped,
        "unpacking_failed": int(bool(fault)),
        "dropouts": file.dropouts,
        "dropout_ms": file.dropout_ms,
        **clean.disorder,
    }
    return SensorLog(
        table,
        gnss,
        readings.NO_HEADINGS,
        mag,
        baro,
        truth,
        reference,
        names,
        clean.dropped,
        {k: v for k, v in damage.items() if v},
        delay,
        {"imu": list(imus), "gnss": list(receivers), "reference": list(references)},
        _messages(file),
        " ".join(file.info[key] for key in ("sys_name", "ver_hw") if key in file.info),
    )


def _sources(file: UlogFile, topics: tuple[str, ...]) -> dict[str, Topic]:
    """Name -> topic of all instances that have data: numbered, but for what the vehicle itself chose."""
    found: dict[str, Topic] = {}
    for name in topics:
        instances = sorted(i for topic, i in file.topics if topic == name)
        bare = name == topics[0] and instances == [0]
        for i in instances:
            found[name if bare else f"{name}.{i}"] = (name, i)
    return found


def _usual(file: UlogFile, sources: dict[str, Topic]) -> str:
    """The first that has about as many messages as any: logs may hold another at a fraction of its rate."""
    most = max(len(file.topics[topic]) for topic in sources.values())
    return next(name for name, topic in sources.items() if len(file.topics[topic]) >= _WORTH * most)


def _stamps(rows: Rows) -> IntArray:
    """When the readings were taken, as far as the message tells, else when it was published; (N,) us."""
    stamps: IntArray = rows["timestamp"].astype(np.int64)
    if "timestamp_sample" in (rows.dtype.names or ()):
        taken = rows["timestamp_sample"].astype(np.int64)
        stamps = np.where((taken > 0) & (taken <= stamps), taken, stamps)
    return stamps


def _imu(topic: str, rows: Rows, clean: Cleaner) -> ImuTable:
    """Samples at the middle of the intervals."""
    if topic == "vehicle_imu":
        t_us, dt_us = _stamps(rows), rows["delta_angle_dt"].astype(np.int64)
        with np.errstate(divide="ignore", invalid="ignore"):
            gyro = rows["delta_angle"] / (rows["delta_angle_dt"] * 1e-6)[:, None]
            accel = rows["delta_velocity"] / (rows["delta_velocity_dt"] * 1e-6)[:, None]
    else:
        t_us, dt_us = rows["timestamp"].astype(np.int64), rows["gyro_integral_dt"].astype(np.int64)
        gyro, accel = rows["gyro_rad"], rows["accelerometer_m_s2"]
    usable = (abs(gyro) <= MAX_GYRO).all(axis=1) & (abs(accel) <= MAX_ACCEL).all(axis=1)
    usable &= (dt_us >= 0) & (dt_us < 1_000_000)
    kept = clean.rows("imu", t_us - dt_us // 2, usable)
    stamps: IntArray = (t_us - dt_us // 2)[kept]
    told = [name for name in rows.dtype.names or () if name.endswith("_clipping")]
    clipped = rows[told[0]][kept] != 0 if told else None
    return ImuTable(stamps, accel[kept].astype(np.float64), gyro[kept].astype(np.float64), clipped)


def _fixes(
    file: UlogFile, topic: Topic, name: str, clean: Cleaner
) -> tuple[Readings[GnssFix], float | None]:
    """The fixes, and their delay: none where the message itself tells when it was measured."""
    rows = file.topics[topic]
    if "latitude_deg" in (rows.dtype.names or ()):
        place = np.column_stack([rows["latitude_deg"], rows["longitude_deg"]])
        alt = rows["altitude_msl_m"]
    else:
        place = np.column_stack([rows["lat"], rows["lon"]]) * 1e-7
        alt = rows["alt"] * 1e-3
    velocity = np.column_stack([rows[f"vel_{axis}_m_s"] for axis in "ned"]).astype(np.float64)
    accuracy = np.column_stack([rows["eph"], rows["epv"], rows["s_variance_m_s"]])
    usable = (abs(place) <= (90.0, 180.0)).all(axis=1) & (abs(alt) <= MAX_ALTITUDE)
    moving = rows["vel_ned_valid"].astype(bool) & (abs(velocity) <= MAX_SPEED).all(axis=1)
    velocity[~moving] = np.nan
    t_us, quality = _stamps(rows), [rows["fix_type"], rows["satellites_used"]]
    kept = clean.rows("gnss", t_us, usable)
    fixes = readings.fixes(
        t_us[kept],
        np.column_stack([np.radians(place), alt])[kept],
        velocity[kept],
        np.column_stack(quality)[kept],
        accuracy[kept],
        name,
    )
    told = file.parameters.get(f"SENS_GPS{topic[1]}_DELAY", file.parameters.get("EKF2_GPS_DELAY"))
    if (t_us != rows["timestamp"].astype(np.int64)).mean() > 0.5:
        told = 0.0
    return fixes, None if told is None else told * 1e-3


def _mags(file: UlogFile, names: dict[str, str], clean: Cleaner) -> Readings[MagSample]:
    """The magnetometer that the vehicle chose and calibrated, or for want of it the first as it is."""
    for name in ("vehicle_magnetometer", "sensor_mag"):
        rows = file.topics.get((name, 0))
        if rows is None:
            continue
        if name == "sensor_mag":
            field = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64)
        else:
            field = rows["magnetometer_ga"].astype(np.float64)
        t_us = _stamps(rows)
        kept = clean.rows("mag", t_us, np.isfinite(field).all(axis=1))
        t_us, field = thinned(t_us[kept], field[kept])
        names["mag"] = name
        return readings.fields(t_us, field, name)
    return readings.NO_FIELDS


def _baros(file: UlogFile, names: dict[str, str], clean: Cleaner) -> Readings[BaroSample]:
    name = "vehicle_air_data"
    rows = file.topics.get((name, 0))
    if rows is None:
        return readings.NO_LEVELS
    t_us, alt = _stamps(rows), rows["baro_alt_meter"].astype(np.float64)
    kept = clean.rows("baro", t_us, abs(alt) <= MAX_ALTITUDE)
    t_us, means = thinned(t_us[kept], alt[kept, None])
    names["baro"] = name
    return readings.levels(t_us, means[:, 0], name)


def _references(file: UlogFile) -> dict[str, tuple[str, str, int]]:
    """Name -> (prefix, suffix, instance) of the estimates in the log: the one that was flown by, and its lanes."""
    found = {}
    if ("vehicle_attitude", 0) in file.topics:
        found["vehicle"] = ("vehicle_", "", 0)
    for i in sorted(i for topic, i in file.topics if topic == "estimator_attitude"):
        found[f"estimator.{i}"] = ("estimator_", "", i)
    return found


def _truth(
    file: UlogFile, prefix: str, suffix: str, instance: int, name: str, clean: Cleaner
) -> Truth | None:
    """Attitude with position and velocity at its stamps, which are logged at rates of their own."""
    attitude = file.topics.get((f"{prefix}attitude{suffix}", instance))
    if attitude is None:
        return None
    t_us, q_lb = _stamps(attitude), attitude["q"].astype(np.float64)
    norm = np.linalg.norm(q_lb, axis=1)
    kept = clean.rows(name, t_us, abs(norm - 1.0) < 0.1)
    t_us, q_lb = t_us[kept], q_lb[kept] / norm[kept, None]
    velocity = place = None
    local = file.topics.get((f"{prefix}local_position{suffix}", instance))
    if local is not None:
        velocity = np.column_stack([local[axis] for axis in ("vx", "vy", "vz")])
        for columns, valid in ((slice(0, 2), "v_xy_valid"), (slice(2, 3), "v_z_valid")):
            velocity[local[valid] == 0, columns] = np.nan
    world = file.topics.get((f"{prefix}global_position{suffix}", instance))
    if world is not None:
        place = np.column_stack(
            [np.radians(world["lat"]), np.radians(world["lon"]), world["alt"]]
        ).astype(np.float64)
    return Truth(t_us, _between(t_us, world, place), _between(t_us, local, velocity), q_lb, name)


def _between(at_us: IntArray, rows: Rows | None, values: FloatArray | None) -> FloatArray:
    """Values (N, 3) at other instants, on lines; nan where there are none."""
    out = np.full((len(at_us), 3), np.nan)
    if rows is None or values is None or len(rows) < 2:
        return out
    t_us, first = np.unique(_stamps(rows), return_index=True)
    values = values[first]
    after = np.searchsorted(t_us, at_us)
    inside = (after > 0) & (after < len(t_us))
    inside[inside] = np.diff(t_us)[after[inside] - 1] < _GAP * 1e6
    for i in range(3):
        out[inside, i] = np.interp(at_us[inside], t_us, values[:, i])
    return out


def _messages(file: UlogFile) -> dict[str, tuple[int, float]]:
    """Topic -> (messages, Hz), an instance after a dot where there are several."""
    several = {name for name, instance in file.counts if instance > 0}
    found = {}
    for (name, instance), count in sorted(file.counts.items()):
        first, last = file.spans[name, instance]
        rate = (count - 1) / ((last - first) * 1e-6) if last > first else 0.0
        found[f"{name}.{instance}" if name in several else name] = (count, rate)
    return found
