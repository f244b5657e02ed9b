"""What an estimator was fed, kept to be fed again: the same samples for every filter of a comparison."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Between, by_turns
from mavins.estimator.settings import Settings
from mavins.types import (
    BaroSample,
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuTable,
    IntArray,
    MagSample,
    Origin,
)

_READINGS: Final = frozenset(("feed_heading", "feed_mag", "feed_baro"))
_TOGETHER: Final = 4096
"""IMU samples that are played together at most."""


class Tape:
    """Takes what an `Estimator` takes, in its place (estimator/feed.py), and plays it to one later.

    `settings` are those to begin with.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.feeds: list[tuple[str, Any]] = []

    def set_origin(self, origin: Origin) -> None:
        """Keep an origin."""
        self.feeds.append(("set_origin", origin))

    def reconfigure(self, settings: Settings, filter_name: str = "") -> None:
        """Keep other settings; which filter it is to be is up to whoever plays it."""
        self.feeds.append(("reconfigure", settings))

    def restart(self, reason: str) -> None:
        """Keep a new beginning."""
        self.feeds.append(("restart", reason))

    def calibrate(self, reason: str) -> bool:
        """Keep the wish; whether the vehicle stands is the estimator's to say."""
        self.feeds.append(("calibrate", reason))
        return True

    def feed_imu(self, table: ImuTable) -> None:
        """Keep IMU samples."""
        self.feeds.append(("feed_imu", table))

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        """Keep IMU samples and readings."""
        by_turns(self, table, between)

    def feed_gnss(self, fix: GnssFix) -> None:
        """Keep a GNSS fix."""
        self.feeds.append(("feed_gnss", fix))

    def feed_heading(self, fix: HeadingFix) -> None:
        """Keep a heading."""
        self.feeds.append(("feed_heading", fix))

    def feed_mag(self, sample: MagSample) -> None:
        """Keep a magnetometer's reading."""
        self.feeds.append(("feed_mag", sample))

    def feed_baro(self, sample: BaroSample) -> None:
        """Keep a barometer's reading."""
        self.feeds.append(("feed_baro", sample))

    def fixes(self) -> tuple[IntArray, FloatArray]:
        """Stamps (N,) in us and places (N, 3: lat, lon in rad, alt in m) of the GNSS fixes."""
        found = [what for name, what in self.feeds if name == "feed_gnss"]
        places = np.array([(fix.lat, fix.lon, fix.alt) for fix in found]).reshape(-1, 3)
        return np.array([fix.t_us for fix in found], dtype=np.int64), places

    def until(self, t_us: int) -> Tape:
        """What came before the first IMU sample after t_us."""
        late = (
            k
            for k, (name, what) in enumerate(self.feeds)
            if name == "feed_imu" and int(what.t_us[0]) > t_us
        )
        return self._with(self.feeds[: next(late, len(self.feeds))])

    def without_changes(self) -> Tape:
        """The same with the settings of the beginning throughout."""
        return self._with([feed for feed in self.feeds if feed[0] != "reconfigure"])

    def thinned(self, every: Mapping[str, int], from_us: int) -> Tape:
        """The same with every n-th alone of what is fed by a name, from a stamp on."""
        seen: Counter[str] = Counter()
        kept = []
        for feed in self.feeds:
            name, what = feed
            if name in every and what.t_us >= from_us:
                seen[name] += 1
                if seen[name] % every[name]:
                    continue
            kept.append(feed)
        return self._with(kept)

    def delay(self) -> float:
        """The delay (s) that fixes come with, their median; 0 without fixes."""
        delays = [what.delay for name, what in self.feeds if name == "feed_gnss"]
        return float(np.median(delays)) if delays else 0.0

    def delayed(self, delay: float) -> Tape:
        """The same with fixes that are this old (s) at their stamps; what they differ among each other stays."""
        later = delay - self.delay()
        return self._with(
            [
                (name, replace(what, delay=what.delay + later) if name == "feed_gnss" else what)
                for name, what in self.feeds
            ]
        )

    def _with(self, feeds: list[tuple[str, Any]]) -> Tape:
        other = Tape(self.settings)
        other.feeds = feeds
        return other

    def play(self, estimator: Estimator) -> None:
        """Feed all of it, IMU samples and the readings between them together, and finish."""
        tables: list[ImuTable] = []
        between: list[Between] = []
        rows = 0
        for name, what in [*self.feeds, ("", None)]:
            if name == "feed_imu":
                tables.append(what)
                rows += len(what)
            elif name in _READINGS and rows:
                between.append((rows, what))
            if (name == "feed_imu" and rows < _TOGETHER) or (name in _READINGS and rows):
                continue
            if tables:
                estimator.feed_run(_joined(tables), between)
                tables, between, rows = [], [], 0
            if name and name != "feed_imu":
                getattr(estimator, name)(what)
        estimator.finish()


def _joined(tables: Sequence[ImuTable]) -> ImuTable:
    if len(tables) == 1:
        return tables[0]
    return ImuTable(
        np.concatenate([table.t_us for table in tables]),
        np.concatenate([table.accel_b for table in tables]),
        np.concatenate([table.gyro_b for table in tables]),
    )
