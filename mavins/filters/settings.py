"""What the filters are told beside the noises of the IMU."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Settings of single filters."""
