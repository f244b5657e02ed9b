"""A folder of CSV files into an estimator: every reading at its stamp, as if it came in at that instant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mavins.estimator.estimator import Estimator
from mavins.estimator.settings import Settings
from mavins.logs.csv_folder import CsvFolder
from mavins.types import GnssFix, HeadingFix, ImuTable


def feed_folder(
    folder: CsvFolder, estimator: Estimator, settings: Settings, progress: Callable[[float], None]
) -> None:
    """Feed all tables merged by their stamps; at one stamp the IMU comes first."""
    imu = folder.imu
    arrivals = _arrivals(folder, settings)
    arrivals.sort(key=lambda item: item.t_us)
    ends = imu.t_us.searchsorted([item.t_us for item in arrivals], "right").tolist()
    fed = 0
    for item, end in zip(arrivals, ends, strict=True):
        if end > fed:
            estimator.feed_imu(_rows(imu, fed, end))
            fed = end
            progress(end / len(imu))
        if isinstance(item, GnssFix):
            estimator.feed_gnss(item)
        else:
            estimator.feed_heading(item)
    if fed < len(imu):
        estimator.feed_imu(_rows(imu, fed, len(imu)))
    progress(1.0)


def _arrivals(folder: CsvFolder, settings: Settings) -> list[GnssFix | HeadingFix]:
    """All measurements with the delays that are configured."""
    gnss_delay = 0.0 if settings.gnss.delay == "auto" else settings.gnss.delay
    return [
        *(replace(fix, delay=gnss_delay) for fix in folder.gnss),
        *(replace(fix, delay=settings.heading.delay) for fix in folder.headings),
    ]


def _rows(imu: ImuTable, first: int, end: int) -> ImuTable:
    return ImuTable(imu.t_us[first:end], imu.accel_b[first:end], imu.gyro_b[first:end])
