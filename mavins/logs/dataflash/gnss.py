"""The receivers in a dataflash log: GPS, what GPA and the parameters say about it, and fixes made of them.

The stamp of a fix is GPA.SMS, when the receiver's message came in: GPS and GPA are logged up to 40 ms later. A fix was
valid a delay before that.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Final

import numpy as np

from mavins.logs import readings
from mavins.logs.dataflash.channels import Channel, Reading
from mavins.logs.dataflash.formats import Batch, Format
from mavins.logs.dataflash.tables import forward
from mavins.logs.readings import Readings
from mavins.mavlink.codec.checks import MAX_ALTITUDE, MAX_SPEED
from mavins.types import FloatArray, GnssFix, HeadingFix, IntArray

DELAY: Final = 0.14
"""Of a fix behind its stamp in s, where the log does not say: what is taken of ArduPilot's telemetry too."""
_DELAYS: Final[dict[float, float]] = {2: 0.12, 5: 0.2, 10: 0.08, 19: 0.11, 21: 0.11}
"""What ArduPilot's drivers take, by GPS_TYPE: u-blox (since generation 7), NMEA, SBF, MSP, external AHRS."""
_LATE_US: Final = 1_000_000
"""No fix is logged later than so long after it came."""


def _possible(rows: FloatArray) -> FloatArray:
    """Fixes, nan where none can be."""
    status, lat, lon, alt = rows[:, :4].T
    wild = (abs(lat) > 90.0) | (abs(lon) > 180.0) | (abs(alt) > MAX_ALTITUDE)
    wild |= (abs(rows[:, 4]) > MAX_SPEED) | (abs(rows[:, 6]) > MAX_SPEED)
    wild |= (status >= 2) & (lat == 0.0) & (lon == 0.0)
    return np.where(wild[:, None], np.nan, rows)


GPS: Final = {
    "GPS": Reading(
        ("Status", "Lat", "Lng", "Alt", "Spd", "GCrs", "[VZ]", "[NSats]", "[Yaw]"), _possible
    )
}
GPA: Final = {"GPA": Reading(("[SMS]", "[HAcc]", "[VAcc]", "[SAcc]", "[VV]", "[YAcc]"))}


class ReceiverParameters:
    """The parameters of the receivers."""

    def __init__(self) -> None:
        self._values: dict[str, float] = {}

    def fields_of(self, form: Format) -> tuple[str, ...]:
        """The fields of PARM."""
        fits = form.name == "PARM" and form.has("Name") and form.has("Value")
        fits = fits and form.character("Name") == "N" and form.character("Value") in "fdiIhH"
        return ("Name", "Value") if fits else ()

    def take(self, batch: Batch) -> None:
        """Keep what is about GNSS, the last value of each."""
        names, values = batch.columns["Name"].tolist(), batch.columns["Value"].tolist()
        for name, value in zip(names, values, strict=True):
            if name.startswith(b"GPS"):
                self._values[name.decode("latin-1")] = value

    def delay(self, number: int) -> float:
        """The delay of receiver 0, 1, ... in s: as it is set, or by its type."""
        of = ((("GPS1_{}", "GPS_{}"), ("GPS2_{}", "GPS_{}2")))[min(number, 1)]
        given = [self._values.get(each.format("DELAY_MS"), 0.0) for each in of]
        kinds = [self._values.get(each.format("TYPE"), 0.0) for each in of]
        for set_ms in given:
            if 0.0 < set_ms <= 1000.0:
                return set_ms * 1e-3
        return next((_DELAYS[kind] for kind in kinds if kind in _DELAYS), DELAY)


def fixes_of(
    gps: Channel, gpa: Channel, dropped: Counter[str]
) -> tuple[Readings[GnssFix], Readings[HeadingFix]]:
    """All fixes of a receiver, and headings where it has two antennas; repeated ones are counted in `dropped`."""
    if gps.source is None:
        return readings.NO_FIXES, readings.NO_HEADINGS
    logged_us, rows = gps.table.t_us, gps.table.rows
    claims = _claims(gps, gpa)
    came_us = np.where(np.isfinite(claims[:, 0]), claims[:, 0] * 1e3, logged_us)
    believed = (came_us <= logged_us) & (logged_us - came_us < _LATE_US)
    t_us = np.where(believed, came_us, logged_us).astype(np.int64)
    chosen = forward(t_us, -1)
    dropped[f"{gps.source} repeated"] += len(t_us) - len(chosen)
    table = np.column_stack([rows, claims[:, 1:]])[chosen]
    source = str(gps.source)
    return _fixes(t_us[chosen], table, source), _headings(t_us[chosen], table, source)


def _claims(gps: Channel, gpa: Channel) -> FloatArray:
    """What GPA says (N, 6) about each row of GPS, with the same stamp; nan where nothing."""
    t_us = gps.table.t_us
    claims = np.full((len(t_us), 6), np.nan)
    if gps.source and gpa.source and gps.source.number == gpa.source.number:
        _, here, there = np.intersect1d(t_us, gpa.table.t_us, True, True)
        claims[here] = gpa.table.rows[there]
    return claims


def _fixes(t_us: IntArray, table: FloatArray, source: str) -> Readings[GnssFix]:
    speed, course, satellites = table[:, 4], np.radians(table[:, 5]), table[:, 7]
    v_d = np.where(table[:, 12] != 0.0, table[:, 6], np.nan)
    velocity = np.column_stack([speed * np.cos(course), speed * np.sin(course), v_d])
    place = np.column_stack([np.radians(table[:, 1:3]), table[:, 3]])
    quality = np.column_stack([table[:, 0], np.where(satellites > 0.0, satellites, np.nan)])
    return readings.fixes(t_us, place, velocity, quality, table[:, 9:12], source)


def _headings(t_us: IntArray, table: FloatArray, source: str) -> Readings[HeadingFix]:
    yaw, sigma = table[:, 8], np.radians(table[:, 13])
    # 0 is said where there is none; north is 360
    kept = np.flatnonzero((table[:, 0] >= 3) & (abs(yaw) > 0.0) & (abs(yaw) <= 360.0))
    wrapped = np.remainder(np.radians(yaw[kept]) + math.pi, math.tau) - math.pi
    claimed = np.where((sigma > 0.0) & np.isfinite(sigma), sigma, np.nan)[kept]
    return readings.headings(t_us[kept], wrapped, claimed, f"{source}.Yaw")
