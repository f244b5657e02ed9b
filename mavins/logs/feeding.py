"""A log of sensors into an estimator: every reading at its stamp, as if it came in at that instant."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress
from typing import TypeAlias, TypeVar

import numpy as np

from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.feed import Feed
from mavins.estimator.settings import Settings
from mavins.estimator.spacing import shortest_us
from mavins.logs.mag_calibration import calibrate
from mavins.logs.sensor_log import SensorLog
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import BaroSample, GnssFix, HeadingFix, MagSample

SettingsT = TypeVar("SettingsT", bound=Settings)
Reading: TypeAlias = GnssFix | HeadingFix | MagSample | BaroSample


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
    ends = imu.t_us.searchsorted([item.t_us for item, _ in arrivals], "right").tolist()
    for (item, in_place), end in zip(arrivals, ends, strict=True):
        if in_place and end > fed:
            estimator.feed_imu(imu.part(slice(fed, end)))
            fed = end
            progress(end / len(imu))
        _feed(estimator, item)
    if fed < len(imu):
        estimator.feed_imu(imu.part(slice(fed, len(imu))))
    progress(1.0)


def _arrivals(log: SensorLog, settings: Settings) -> list[tuple[Reading, bool]]:
    """All measurements with the delays that are configured, by their stamps; False for those that will only be noted,
    whose place among the IMU's samples does not matter: a barometer's readings beyond its highest rate.
    """
    delay, baro = settings.gnss.delay, settings.baro
    fixes = (fix if delay == "auto" else replace(fix, delay=delay) for fix in log.gnss)
    headings = (replace(fix, delay=settings.heading.delay) for fix in log.headings)
    mag = compress(log.mag, _due(log.mag, settings.magnetometer.max_rate))
    levels = log.baro if baro.enabled else []
    placed: list[Reading] = [*fixes, *headings, *mag]
    arrivals: list[tuple[Reading, bool]] = [(item, True) for item in placed]
    arrivals += zip(levels, _due(levels, baro.max_rate), strict=True)
    arrivals.sort(key=lambda arrival: arrival[0].t_us)
    return arrivals


def _due(readings: Sequence[MagSample | BaroSample], max_rate: float) -> list[bool]:
    """True for the readings that are not too soon after the last such one, by the estimator's own rule."""
    due: list[bool] = []
    last_us = -math.inf
    for reading in readings:
        due.append(reading.t_us - last_us >= shortest_us(max_rate))
        if due[-1]:
            last_us = reading.t_us
    return due


def _feed(estimator: Feed, item: Reading) -> None:
    match item:
        case GnssFix():
            estimator.feed_gnss(item)
        case HeadingFix():
            estimator.feed_heading(item)
        case MagSample():
            estimator.feed_mag(item)
        case BaroSample():
            estimator.feed_baro(item)
