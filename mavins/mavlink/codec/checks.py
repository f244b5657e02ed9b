"""What the decoders share: which values a sensor can have, and what stands for 'not known'."""

from __future__ import annotations

import math
from typing import Final

MAX_ACCEL: Final = 2000.0
"""m/s^2; no sensor of a vehicle reads more, so more is damage."""
MAX_GYRO: Final = 100.0
"""rad/s, likewise."""
MAX_ANGLE: Final = 7.0
"""rad, a turn to either side."""
MAX_SPEED: Final = 1000.0
"""m/s, likewise."""
MAX_ALTITUDE: Final = 100_000.0
"""m, likewise."""
STAMP_LIMIT: Final = 2**62
"""Microseconds; a greater stamp is damage (and would not fit into int64 arithmetic)."""
U16: Final = 0xFFFF
U32: Final = 0xFFFFFFFF
_DEG_E7: Final = math.radians(1e-7)
_CDEG: Final = math.radians(1e-2)


class UnusableError(Exception):
    """Raised inside a decoder, never out of `decode`; the text is the reason."""


def check(in_range: bool, reason: str) -> None:
    """UnusableError with the reason, unless it is in range."""
    if not in_range:
        raise UnusableError(reason)


def finite(*values: float) -> None:
    """All values are finite."""
    check(all(map(math.isfinite, values)), "not a finite number")


def position(lat_e7: int, lon_e7: int, alt: float, fix_type: int = 3) -> tuple[float, float]:
    """(lat, lon) in rad; latitude 0 / longitude 0 with a fix is how receivers say 'nowhere'."""
    check(abs(lat_e7) <= 900_000_000 and abs(lon_e7) <= 1_800_000_000, "position out of range")
    check(abs(alt) <= MAX_ALTITUDE, "altitude out of range")
    check(fix_type < 2 or lat_e7 != 0 or lon_e7 != 0, "position 0/0")
    return lat_e7 * _DEG_E7, lon_e7 * _DEG_E7


def speed_in_range(*components: float) -> None:
    """All components are of a velocity that a vehicle can have."""
    finite(*components)
    check(all(abs(v) <= MAX_SPEED for v in components), "velocity out of range")


def known(raw: int, unknown: int, scale: float) -> float | None:
    """An accuracy in SI; zero and the type's maximum mean that the receiver does not know it."""
    return None if raw in (0, unknown) else raw * scale


def heading(cdeg: int) -> float | None:
    """A heading in [0, 2 pi): 0 means none, 36000 north, anything above not available."""
    return None if cdeg == 0 or cdeg > 36000 else cdeg % 36000 * _CDEG


def course(cdeg: int) -> float | None:
    """A direction in [0, 2 pi); above 36000 it is not known."""
    return None if cdeg > 36000 else cdeg % 36000 * _CDEG
