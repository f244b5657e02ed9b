"""Where and when: a track for maps, the time of day, and attitudes in n."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.estimates import Result
from mavins.nav.rotations import quat_product
from mavins.types import FloatArray, IntArray

TRACK_US: Final = 500_000
"""Points of a track for maps are at least so far apart: they show no more, and choke on more."""
GAP_US: Final = 2_000_000
"""A longer time without a point parts a track."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Points without a gap: `t_us` (N,), and `degrees` (N, 3): latitude and longitude in deg, altitude in m."""

    t_us: IntArray
    degrees: FloatArray


def utc_offset_us(result: Result) -> int | None:
    """UTC minus the clock of the stamps, or None where the vehicle has not told."""
    offset = result.summary.get("utc_offset_us")
    return int(offset) if isinstance(offset, int | float) else None


def utc_texts(t_us: IntArray, offset_us: int | None) -> list[str]:
    """Instants (N,) as in ISO 8601; nothing where the vehicle has not told UTC."""
    if offset_us is None:
        return [""] * len(t_us)
    texts = np.datetime_as_string((t_us + offset_us).astype("datetime64[us]"), unit="ms")
    return [f"{text}Z" for text in texts.tolist()]


def tracks(result: Result) -> Iterator[tuple[str, list[Stretch]]]:
    """The estimate, and GNSS where it was kept, each with its stretches."""
    yield "estimate", stretches(result.t_us, in_degrees(result.lla))
    if result.evidence is not None and len(result.evidence.gnss.t_us):
        gnss = result.evidence.gnss
        fixed = gnss.fix_type >= 3
        yield "GNSS", stretches(gnss.t_us[fixed], in_degrees(gnss.lla[fixed]))


def in_degrees(lla: FloatArray) -> FloatArray:
    """Latitude and longitude (N, 3) in deg, altitude in m, of the same in rad and m."""
    return np.column_stack([np.degrees(lla[:, :2]), lla[:, 2]])


def stretches(t_us: IntArray, degrees: FloatArray) -> list[Stretch]:
    """Points thinned out, and parted at gaps."""
    usable = np.isfinite(degrees).all(axis=1)
    t_us, degrees = t_us[usable], degrees[usable]
    kept = np.flatnonzero(np.diff(t_us // TRACK_US, prepend=-1) != 0)
    t_us, degrees = t_us[kept], degrees[kept]
    parts = np.flatnonzero((np.diff(t_us) > GAP_US) | (np.diff(t_us) < 0)) + 1
    edges = [0, *parts.tolist(), len(t_us)]
    return [Stretch(t_us[a:b], degrees[a:b]) for a, b in pairwise(edges) if b > a]


def origin_of(result: Result) -> tuple[float, float, float]:
    """The origin of n: latitude and longitude in rad, altitude in m. Raises LogFormatError where it is not told."""
    origin = result.summary.get("origin")
    if not isinstance(origin, dict):
        raise LogFormatError("summary.json does not tell the origin of n: replay the log again")
    return (
        float(np.radians(origin["lat_deg"])),
        float(np.radians(origin["lon_deg"])),
        origin["alt_m"],
    )


def attitude_in_n(result: Result) -> FloatArray:
    """The quaternions (N, 4), scalar first, from body to n; what is estimated is from body to local level."""
    lat, lon, _ = origin_of(result)
    q_el = _level_to_earth(result.lla[:, 0], result.lla[:, 1])
    q_ne = _level_to_earth(np.array([lat]), np.array([lon])) * np.array([1.0, -1.0, -1.0, -1.0])
    return quat_product(quat_product(q_ne, q_el), result.quaternions)


def _level_to_earth(lat: FloatArray, lon: FloatArray) -> FloatArray:
    """q_el (N, 4): a turn by the longitude about the third axis, then by -(90 deg + latitude) about the second."""
    a, b, zero = 0.5 * lon, -0.5 * (lat + 0.5 * np.pi), np.zeros_like(lat)
    about_z = np.column_stack([np.cos(a), zero, zero, np.sin(a)])
    about_y = np.column_stack([np.cos(b), zero, np.sin(b), zero])
    return quat_product(about_z, about_y)
