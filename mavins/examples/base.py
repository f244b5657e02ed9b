"""What an example is: data in, lines and files out, and figures with limits that it holds itself against."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mavins.errors import MavinsError


class MissingDataError(MavinsError):
    """The data that an example works on are not there."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that an example states: `value` must not exceed `limit` (both in `unit`)."""

    name: str
    value: float
    limit: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """True where the value keeps its limit; a value that is not a number does not."""
        return self.value <= self.limit and not math.isnan(self.value)

    def line(self) -> str:
        """The figure as a line of text."""
        mark = "ok  " if self.holds else "FAIL"
        return f"{mark}  {self.name}: {self.value:.4g} {self.unit} (at most {self.limit:g})"


class Example(Protocol):
    """What a module of `mavins/examples/` offers."""

    def run(
        self, data: Path | None, out: Path | None, say: Callable[[str], None]
    ) -> Sequence[Figure]:
        """Run on the folder `data`, write pictures and tables into `out` if one is given, say what is done.

        `data` is None where no folder of data is known; MissingDataError where what is needed is not in it.
        """


def needed(data: Path | None, *parts: str) -> Path:
    """The path below the folder of data; MissingDataError says how to name one."""
    if data is None:
        raise MissingDataError("no folder of data: name one with --data DIR or $MAVINS_DATA")
    path = data.joinpath(*parts)
    if not path.exists():
        raise MissingDataError(
            f"{path} is missing: name the folder of data with --data or $MAVINS_DATA"
        )
    return path
