"""What the filters are told beside the noises of the IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le

from mavins.documented import Doc


@dataclass(frozen=True, slots=True)
class IteratedSettings:
    """The iterated update of `ieskf`."""

    iterations: Annotated[
        int, Ge(1), Le(100), Doc("At most this many linearizations of a measurement.")
    ] = 4
    threshold: Annotated[
        float,
        Gt(0),
        Le(1),
        Doc("A change of the state by less than this, in its sigmas, is the last."),
    ] = 0.01


@dataclass(frozen=True, slots=True)
class SrcdkfSettings:
    """Of the square-root central-difference filter: `full` takes its full second-order form, which is slower."""

    full: bool = False


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Settings of single filters."""

    srcdkf: SrcdkfSettings = SrcdkfSettings()
    iterated: IteratedSettings = IteratedSettings()
