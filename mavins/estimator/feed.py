"""What a source of samples and measurements feeds: an estimator, or whatever stands in its place."""

from __future__ import annotations

from typing import Protocol

from mavins.estimator.settings import Settings
from mavins.types import BaroSample, GnssFix, HeadingFix, ImuTable, MagSample, Origin


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

    def feed_gnss(self, fix: GnssFix) -> None:
        """Take a GNSS fix."""

    def feed_heading(self, fix: HeadingFix) -> None:
        """Take a heading."""

    def feed_mag(self, sample: MagSample) -> None:
        """Take a magnetometer's reading."""

    def feed_baro(self, sample: BaroSample) -> None:
        """Take a barometer's reading."""
