"""What the filters are told beside the noises of the IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le

from mavins.documented import Doc


@dataclass(frozen=True, slots=True)
class EulerEkfSettings:
    """The Euler-angle filter `euler_ekf`."""

    compat: Annotated[
        bool,
        Doc("Step and noises of the published original, blemishes included, in place of our own."),
    ] = False


@dataclass(frozen=True, slots=True)
class IteratedSettings:
    """The iterated update of `ieskf` and `iekf`."""

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
    """The square-root central-difference filter `srcdkf`."""

    full: Annotated[
        bool,
        Doc("The full second-order form, which is slower, in place of the structural one."),
    ] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Settings of single filters."""

    euler_ekf: EulerEkfSettings = EulerEkfSettings()
    iterated: IteratedSettings = IteratedSettings()
    srcdkf: SrcdkfSettings = SrcdkfSettings()
