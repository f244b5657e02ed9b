"""A log of sensors into an estimator: every reading at its stamp, as if it came in at that instant."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Final, TypeVar

import numpy as np

from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.feed import Between, Feed
from mavins.estimator.settings import Settings
from mavins.estimator.spacing import shortest_us
from mavins.logs.mag_calibration import calibrate
from mavins.logs.readings import Readings
from mavins.logs.sensor_log import SensorLog
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import GnssFix, IntArray, Reading

SettingsT = TypeVar("SettingsT", bound=Settings)
_TOGETHER: Final = 4096
"""IMU samples that are fed together at most."""


def settled(settings: SettingsT, log: SensorLog) -> SettingsT:
    """The settings with what is `auto` decided by what the log holds, the magnetometer's calibration included."""
    delay = settings.gnss.delay
    if delay == "auto":
        delay = log.gnss_delay or 0.0
    return replace(
        settings,
        gnss=replace(settings.gnss, delay=delay),
        magnetometer=_magnetometer(settings, log),
    )


def _magnetometer(settings: Settings, log: SensorLog) -> MagnetometerSettings:
    s = settings.magnetometer
    enabled = s.enabled if s.enabled != "auto" else not log.headings
    if not log.mag or not enabled:
        return replace(s, enabled=False)
    if s.rotation == "auto" or s.hard_iron == "auto":
        C = quat_to_dcm(euler_to_quat(*settings.imu.rotation))
        found = calibrate(
            log.imu.t_us,
            log.imu.gyro_b,
            log.mag.t_us - round((s.delay - settings.imu.delay) * 1e6),
            log.mag.rows,
            None if s.rotation == "auto" else s.rotation,
            C,
        )
        hard_iron = found.hard_iron if s.hard_iron == "auto" else s.hard_iron
        s = replace(s, rotation=found.rotation, hard_iron=hard_iron)
    return replace(s, enabled=True)


def feed_log(
    log: SensorLog, estimator: Feed, settings: Settings, progress: Callable[[float], None]
) -> None:
    """Feed all tables merged by their stamps, with `settled` settings; at one stamp the IMU comes first."""
    imu, fed = log.imu, 0
    between: list[Between] = []
    for item, end in _arrivals(log, settings):
        if end - fed >= _TOGETHER or isinstance(item, GnssFix):
            estimator.feed_run(imu[fed:end], between)
            between, fed = [], end
            progress(end / len(imu))
        if isinstance(item, GnssFix):
            estimator.feed_gnss(item)
        else:
            between.append((end - fed, item))
    estimator.feed_run(imu[fed:], between)
    progress(1.0)


def _arrivals(log: SensorLog, settings: Settings) -> Iterator[tuple[GnssFix | Reading, int]]:
    """All measurements with the delays that are configured, by their stamps, and how many IMU samples come before."""
    delay = settings.gnss.delay
    mag = log.mag.at(_due(log.mag.t_us, settings.magnetometer.max_rate))
    tables: list[Readings[Any]] = [log.gnss, log.headings, mag]
    if settings.baro.enabled:
        tables.append(log.baro)
    items: list[Iterator[GnssFix | Reading]] = [
        iter(log.gnss) if delay == "auto" else (replace(fix, delay=delay) for fix in log.gnss),
        (replace(fix, delay=settings.heading.delay) for fix in log.headings),
        iter(mag),
        iter(log.baro),
    ]
    stamps = np.concatenate([table.t_us for table in tables])
    which = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    order = np.argsort(stamps, kind="stable")
    ends = log.imu.t_us.searchsorted(stamps[order], "right")
    for k in range(0, len(order), _TOGETHER):
        part = slice(k, k + _TOGETHER)
        for source, end in zip(which[order[part]].tolist(), ends[part].tolist(), strict=True):
            yield next(items[source]), end


def _due(t_us: IntArray, max_rate: float) -> IntArray:
    """Which readings are not too soon after the last such one, by the estimator's own rule."""
    due: list[int] = []
    last_us, shortest = -math.inf, shortest_us(max_rate)
    for k, stamp in enumerate(t_us.tolist()):
        if stamp - last_us >= shortest:
            due.append(k)
            last_us = stamp
    return np.array(due, dtype=np.int64)
