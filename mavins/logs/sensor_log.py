"""What a log of sensors holds, whatever its format: tables of readings on one clock, in the order of their stamps."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from mavins.errors import LogFormatError
from mavins.logs.readings import Readings
from mavins.logs.truth import Truth
from mavins.types import BaroSample, GnssFix, HeadingFix, ImuTable, MagSample


@dataclass(frozen=True, slots=True)
class Choice:
    """Which of a log's sources are asked for, by name or number as the log has them; None: the usual one."""

    imu: str | None = None
    gnss: str | None = None
    reference: str | None = None


DEFAULT: Final = Choice()


def chosen(what: str, wanted: str | None, names: Sequence[str], usual: str) -> str:
    """The one of a log's `names` that is `wanted`, by itself or by the number that it ends in; LogFormatError if none.

    A number that several end in means the last of them.
    """
    if wanted is None:
        return usual
    if wanted in names:
        return wanted
    if wanted.isdecimal():
        for name in reversed(names):
            if re.fullmatch(rf".*?\D0*{int(wanted)}\D?", name):
                return name
    have = ", ".join(names) or "none"
    raise LogFormatError(f"the log has no {what} called {wanted[:40]!r}; it has {have}")


@dataclass(frozen=True, slots=True)
class SensorLog:
    """Readings of one vehicle; `t_us` counts microseconds on the IMU's clock everywhere.

    `truth` is what a simulator knew, `reference` what the vehicle's own filter said: both for evaluation only.
    `names` says where each table ("imu", "gnss", "heading", "mag", "baro", "truth", "reference") comes from in the
    log; `dropped` counts the rows that hold no reading, by reason; `damage` what could not be read.
    `gnss_delay` is the delay of the fixes in s that the vehicle was told or its driver knows, None where the log does
    not say. `choices` are the names of the sources that could be chosen, per table; `messages` the kinds of messages
    in the log with their number and rate in Hz, `about` the vehicle in words, for people.
    """

    imu: ImuTable
    gnss: Readings[GnssFix]
    headings: Readings[HeadingFix]
    mag: Readings[MagSample]
    baro: Readings[BaroSample]
    truth: Truth | None
    reference: Truth | None
    names: Mapping[str, str]
    dropped: Counter[str]
    damage: Mapping[str, int]
    gnss_delay: float | None = None
    choices: Mapping[str, Sequence[str]] = field(default_factory=dict)
    messages: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    about: str = ""

    @property
    def counts(self) -> dict[str, int]:
        """How many readings there are of each source."""
        sizes = {
            "imu": len(self.imu),
            "gnss": len(self.gnss),
            "heading": len(self.headings),
            "mag": len(self.mag),
            "baro": len(self.baro),
        }
        return {self.names[table]: n for table, n in sizes.items() if n}

    @property
    def seconds(self) -> float:
        """How long the IMU was recorded."""
        return float(self.imu.t_us[-1] - self.imu.t_us[0]) * 1e-6
