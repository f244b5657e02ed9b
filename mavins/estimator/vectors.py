"""Kinds of vectors that settings hold."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Le

Vector3 = tuple[float, float, float]
_Arm = Annotated[float, Ge(-100), Le(100)]
LeverArm = tuple[_Arm, _Arm, _Arm]
