"""What every settings dataclass of the simulator shares: strict checking and bounds of numbers."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from annotated_types import Ge, Gt, Le
from pydantic import AfterValidator, ConfigDict

NonNegative: TypeAlias = Annotated[float, Ge(0.0)]
Positive: TypeAlias = Annotated[float, Gt(0.0)]


def _whole_milliseconds(rate: int) -> int:
    if 1000 % rate:
        raise ValueError("must divide 1000: 1, 2, 4, 5, 8, 10, ... 250, 500, 1000")
    return rate


Rate: TypeAlias = Annotated[int, Ge(1), Le(1000), AfterValidator(_whole_milliseconds)]
"""A rate in Hz whose period is a whole number of ms, because some messages carry boot ms."""


class Settings:
    """Base of the settings: an unknown key or a value of the wrong kind is refused."""

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
