"""What the filters are told beside the noises of the IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from mavins.documented import Doc


@dataclass(frozen=True, slots=True)
class EulerEkfSettings:
    """The Euler-angle filter."""

    compat: Annotated[
        bool,
        Doc("Step and noises of the published original, blemishes included, in place of our own."),
    ] = False


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Settings of single filters."""

    euler_ekf: EulerEkfSettings = EulerEkfSettings()
