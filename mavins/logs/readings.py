"""Readings of a log as columns: numbers while they wait, objects when they are asked for.

Hours of fixes, headings, fields and pressures would take ten times the memory as objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final, TypeAlias, TypeVar, overload

import numpy as np

from mavins.types import BaroSample, FloatArray, GnssFix, HeadingFix, IntArray, MagSample

T = TypeVar("T")
Make: TypeAlias = Callable[[int, list[float]], T]
_TOGETHER: Final = 1024


class Readings(Sequence[T]):
    """Readings with stamps `t_us` (N,), in the order of time, and numbers `rows` (N, m), of which `make` makes one."""

    def __init__(self, t_us: IntArray, rows: FloatArray, make: Make[T]) -> None:
        self.t_us, self.rows = t_us, rows
        self._make = make

    def __len__(self) -> int:
        return len(self.t_us)

    @overload
    def __getitem__(self, k: int) -> T: ...

    @overload
    def __getitem__(self, k: slice) -> Readings[T]: ...

    def __getitem__(self, k: int | slice) -> T | Readings[T]:
        if isinstance(k, slice):
            return Readings(self.t_us[k], self.rows[k], self._make)
        return self._make(int(self.t_us[k]), self.rows[k].tolist())

    def __iter__(self) -> Iterator[T]:
        for k in range(0, len(self), _TOGETHER):
            part = slice(k, k + _TOGETHER)
            stamps, rows = self.t_us[part].tolist(), self.rows[part].tolist()
            yield from map(self._make, stamps, rows)

    def at(self, chosen: IntArray) -> Readings[T]:
        """Some of them."""
        return Readings(self.t_us[chosen], self.rows[chosen], self._make)


def fixes(
    t_us: IntArray,
    place: FloatArray,
    velocity: FloatArray,
    quality: FloatArray,
    sigmas: FloatArray,
    source: str,
) -> Readings[GnssFix]:
    """GNSS fixes at (latitude, longitude in rad, altitude in m) (N, 3), with NED velocity (N, 3) in m/s.

    Fix type and number of satellites (N, 2); claims of sigma (N, 3), horizontal, vertical, of velocity. What is nan is
    not given, of the velocity all of it where a level component is; a claim that is not positive is none.
    """
    rows = np.column_stack([place, velocity, quality, sigmas]).astype(np.float64, copy=False)
    return Readings(t_us, rows, partial(_fix, source))


def headings(
    t_us: IntArray, yaw: FloatArray, sigma: FloatArray, source: str
) -> Readings[HeadingFix]:
    """Headings (N,) in rad, with their sigmas, nan where none is given."""
    return Readings(t_us, np.column_stack([yaw, sigma]), partial(_heading, source))


def fields(t_us: IntArray, field: FloatArray, source: str) -> Readings[MagSample]:
    """A magnetometer's readings (N, 3)."""
    return Readings(t_us, field, partial(_field, source))


def levels(t_us: IntArray, alt: FloatArray, source: str) -> Readings[BaroSample]:
    """A barometer's altitudes (N,) in m."""
    return Readings(t_us, alt[:, np.newaxis], partial(_level, source))


def _fix(source: str, t_us: int, row: list[float]) -> GnssFix:
    lat, lon, alt, v_n, v_e, v_d, fix_type, satellites, sigma_h, sigma_v, sigma_speed = row
    return GnssFix(
        t_us,
        lat,
        lon,
        alt,
        None if math.isnan(v_n) or math.isnan(v_e) else (v_n, v_e, v_d),
        int(fix_type),
        None if math.isnan(satellites) else int(satellites),
        _claim(sigma_h),
        _claim(sigma_v),
        _claim(sigma_speed),
        source,
    )


def _claim(sigma: float) -> float | None:
    return sigma if 0.0 < sigma < math.inf else None


def _heading(source: str, t_us: int, row: list[float]) -> HeadingFix:
    yaw, sigma = row
    return HeadingFix(t_us, yaw, None if math.isnan(sigma) else sigma, source)


def _field(source: str, t_us: int, row: list[float]) -> MagSample:
    return MagSample(t_us, np.array(row), source)


def _level(source: str, t_us: int, row: list[float]) -> BaroSample:
    return BaroSample(t_us, row[0], source)


_NEVER: Final[IntArray] = np.empty(0, dtype=np.int64)
_NOTHING: Final[FloatArray] = np.empty((0, 3))
NO_FIXES: Final = fixes(_NEVER, _NOTHING, _NOTHING, _NOTHING[:, :2], _NOTHING, "")
NO_HEADINGS: Final = headings(_NEVER, np.empty(0), np.empty(0), "")
NO_FIELDS: Final = fields(_NEVER, _NOTHING, "")
NO_LEVELS: Final = levels(_NEVER, np.empty(0), "")
