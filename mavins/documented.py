"""The note that a settings field carries about itself: what it is, and in which unit.

    gyro_noise: Annotated[float, Gt(0), Doc("Gyro noise density.", unit="rad/s/sqrt(Hz)")] = 0.015

The commented YAML of `mavins config` and the error messages of `mavins.config` read it from there,
so that a setting is described in one place only.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Doc:
    """What a setting means, in a sentence or two, and its unit where it has one."""

    text: str
    unit: str = ""
