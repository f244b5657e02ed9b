"""What the filters are told beside the noises of the IMU."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SrcdkfSettings:
    """Of the square-root central-difference filter: `full` takes its full second-order form, which is slower."""

    full: bool = False


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Settings of single filters."""

    srcdkf: SrcdkfSettings = SrcdkfSettings()
