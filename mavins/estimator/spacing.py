"""How close two readings may follow each other where a highest rate is set."""

from __future__ import annotations

from typing import Final

_SLACK: Final = 0.95
"""Stamps on a grid must not fall just short of the highest rate."""


def shortest_us(max_rate: float) -> float:
    """The shortest interval in us between readings that are taken at up to `max_rate` in Hz."""
    return _SLACK * 1e6 / max_rate
