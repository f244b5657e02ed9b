"""What a source of samples and measurements feeds: an estimator, or whatever stands in its place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

from mavins.estimator.settings import Settings
from mavins.types import BaroSample, GnssFix, HeadingFix, ImuTable, MagSample, Origin, Reading

Between: TypeAlias = tuple[int, Reading]
"""A reading, and after how many samples of a table it came."""


class Feed(Protocol):
    """The way in; `Estimator` says what each of these does."""

    settings: Settings

    def set_origin(self, origin: Origin) -> None:
        """Put the origin of n here."""

    def reconfigure(self, settings: Settings, filter_name: str = "") -> None:
        """Go on with other settings, and another filter if one is named."""

    def restart(self, reason: str) -> None:
        """Forget all samples and the estimate."""

    def calibrate(self, reason: str) -> bool:
        """Align anew where the vehicle stands; False where it does not."""

    def feed_imu(self, table: ImuTable) -> None:
        """Take IMU samples."""

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        """Take IMU samples and readings by turns; the outcome is that of feeding them one after the other."""

    def feed_gnss(self, fix: GnssFix) -> None:
        """Take a GNSS fix."""

    def feed_heading(self, fix: HeadingFix) -> None:
        """Take a heading."""

    def feed_mag(self, sample: MagSample) -> None:
        """Take a magnetometer's reading."""

    def feed_baro(self, sample: BaroSample) -> None:
        """Take a barometer's reading."""


def by_turns(feed: Feed, table: ImuTable, between: Sequence[Between]) -> None:
    """Feed IMU samples and the readings between them one after the other."""
    start = 0
    for rows, reading in between:
        if rows > start:
            feed.feed_imu(table[start:rows])
            start = rows
        feed_reading(feed, reading)
    if start < len(table):
        feed.feed_imu(table[start:])


def feed_reading(feed: Feed, reading: Reading) -> None:
    """Feed one reading."""
    match reading:
        case HeadingFix():
            feed.feed_heading(reading)
        case MagSample():
            feed.feed_mag(reading)
        case BaroSample():
            feed.feed_baro(reading)


class Relay:
    """A `Feed` that hands everything on to another; a subclass looks at what it is after."""

    def __init__(self, feed: Feed) -> None:
        self.feed = feed

    @property
    def settings(self) -> Settings:
        """Those of whom it stands in front of."""
        return self.feed.settings

    @settings.setter
    def settings(self, settings: Settings) -> None:
        self.feed.settings = settings

    def set_origin(self, origin: Origin) -> None:
        """Hand on an origin."""
        self.feed.set_origin(origin)

    def reconfigure(self, settings: Settings, filter_name: str = "") -> None:
        """Hand on other settings."""
        self.feed.reconfigure(settings, filter_name)

    def restart(self, reason: str) -> None:
        """Hand on a new beginning."""
        self.feed.restart(reason)

    def calibrate(self, reason: str) -> bool:
        """Hand on the wish."""
        return self.feed.calibrate(reason)

    def feed_imu(self, table: ImuTable) -> None:
        """Hand on IMU samples."""
        self.feed.feed_imu(table)

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        """Hand on IMU samples and readings, one after the other."""
        by_turns(self, table, between)

    def feed_gnss(self, fix: GnssFix) -> None:
        """Hand on a GNSS fix."""
        self.feed.feed_gnss(fix)

    def feed_heading(self, fix: HeadingFix) -> None:
        """Hand on a heading."""
        self.feed.feed_heading(fix)

    def feed_mag(self, sample: MagSample) -> None:
        """Hand on a magnetometer's reading."""
        self.feed.feed_mag(sample)

    def feed_baro(self, sample: BaroSample) -> None:
        """Hand on a barometer's reading."""
        self.feed.feed_baro(sample)
