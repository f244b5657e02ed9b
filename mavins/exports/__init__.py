"""What a result is made into for other tools: a module per format, and a line here.

A module has `FILES`, the names that it writes into the filter's folder; `NEEDS`, the modules of the extra `export` that
it cannot do without; and `write(result, folder)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Protocol, cast

from mavins.errors import ConfigError
from mavins.estimates import Result
from mavins.exports import gpx, kml, mcap, parquet, tum


class Export(Protocol):
    """A format."""

    FILES: tuple[str, ...]
    NEEDS: tuple[str, ...]

    def write(self, result: Result, folder: Path) -> None:
        """Write the files. Raises OSError where that cannot be."""


REGISTRY: Final = {
    "tum": cast(Export, tum),
    "kml": cast(Export, kml),
    "gpx": cast(Export, gpx),
    "parquet": cast(Export, parquet),
    "mcap": cast(Export, mcap),
}
USUAL: Final = ("tum", "kml", "gpx", "parquet")
"""What takes little time and room, and is made without being asked for, where what it needs is installed."""
TLOG: Final = "tlog"
"""Our messages are made while the log runs: they tell more than a result folder holds (mavins/output_tlog.py)."""
OUTPUT_TLOG: Final = "output.tlog"
FILES: Final = (*(name for export in REGISTRY.values() for name in export.FILES), OUTPUT_TLOG)


def formats_of(text: str, known: Sequence[str]) -> tuple[str, ...]:
    """The formats that a user names: comma-separated, `all`, `none`, or `usual`.

    Raises ConfigError for an unknown one, ModuleNotFoundError for one that was named and lacks its extra.
    """
    if text == "none":
        return ()
    if text == "usual":
        return tuple(name for name in USUAL if is_installed(name))
    names = tuple(known) if text == "all" else tuple(dict.fromkeys(text.split(",")))
    for name in names:
        if name not in known:
            raise ConfigError(f"no format {name!r}; there are: {', '.join(known)}, all, none")
        for module in REGISTRY[name].NEEDS if name in REGISTRY else ():
            if find_spec(module) is None:
                raise ModuleNotFoundError(name=module)
    return names


def is_installed(name: str) -> bool:
    """True where all is there that a format needs."""
    return all(find_spec(module) is not None for module in REGISTRY[name].NEEDS)


def write_exports(result: Result, names: Sequence[str], folder: Path) -> None:
    """Write a result in other formats into a folder."""
    for name in names:
        if name in REGISTRY:
            REGISTRY[name].write(result, folder)
