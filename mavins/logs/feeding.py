"""A log of sensors into an estimator: every reading at its stamp, as if it came in at that instant."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress
from typing import Final, TypeVar

import numpy as np

from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.feed import Between, Feed
from mavins.estimator.settings import Settings
from mavins.estimator.spacing import shortest_us
from mavins.logs.mag_calibration import calibrate
from mavins.logs.sensor_log import SensorLog
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import GnssFix, MagSample, Reading

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
            log.imu.t_us - round((settings.imu.delay) * 1e6),
            log.imu.gyro_b @ C.T,
            np.array([sample.t_us for sample in log.mag]) - round(s.delay * 1e6),
            np.array([sample.field for sample in log.mag]),
            None if s.rotation == "auto" else s.rotation,
        )
        hard_iron = found.hard_iron if s.hard_iron == "auto" else s.hard_iron
        s = replace(s, rotation=found.rotation, hard_iron=hard_iron)
    return replace(s, enabled=True)


def feed_log(
    log: SensorLog, estimator: Feed, settings: Settings, progress: Callable[[float], None]
) -> None:
    """Feed all tables merged by their stamps, with `settled` settings; at one stamp the IMU comes first."""
    imu, fed = log.imu, 0
    arrivals = _arrivals(log, settings)
    ends = imu.t_us.searchsorted([item.t_us for item in arrivals], "right").tolist()
    between: list[Between] = []
    for item, end in zip(arrivals, ends, strict=True):
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


def _arrivals(log: SensorLog, settings: Settings) -> list[GnssFix | Reading]:
    """All measurements with the delays that are configured, by their stamps."""
    delay = settings.gnss.delay
    fixes = (fix if delay == "auto" else replace(fix, delay=delay) for fix in log.gnss)
    headings = (replace(fix, delay=settings.heading.delay) for fix in log.headings)
    mag = compress(log.mag, _due(log.mag, settings.magnetometer.max_rate))
    levels = log.baro if settings.baro.enabled else []
    arrivals: list[GnssFix | Reading] = [*fixes, *headings, *mag, *levels]
    arrivals.sort(key=lambda item: item.t_us)
    return arrivals


def _due(readings: Sequence[MagSample], max_rate: float) -> list[bool]:
    """True for the readings that are not too soon after the last such one, by the estimator's own rule."""
    due: list[bool] = []
    last_us = -math.inf
    for reading in readings:
        due.append(reading.t_us - last_us >= shortest_us(max_rate))
        if due[-1]:
            last_us = reading.t_us
    return due
