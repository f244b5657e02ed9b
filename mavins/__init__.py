"""mavins: a MAVLink companion service that turns sensor messages into a navigation solution.

In Python, a log is run as `mavins replay` does it: `mavins.run("flight.tlog").plot()` (docs/reference/api.md).
"""

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavins.config import Config
    from mavins.config import load as load_config
    from mavins.estimates import Estimates, Innovations, Result
    from mavins.evaluation.result_folder import read_result
    from mavins.runs import run
    from mavins.sources import Log, open_log

try:
    __version__ = version("mavins")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0.0.0+source"

_PLACES = {
    "Config": ("mavins.config", "Config"),
    "Estimates": ("mavins.estimates", "Estimates"),
    "Innovations": ("mavins.estimates", "Innovations"),
    "Log": ("mavins.sources", "Log"),
    "Result": ("mavins.estimates", "Result"),
    "load_config": ("mavins.config", "load"),
    "open_log": ("mavins.sources", "open_log"),
    "read_result": ("mavins.evaluation.result_folder", "read_result"),
    "run": ("mavins.runs", "run"),
}
"""What the package offers -> where it is: imported when it is first asked for, so that `mavins --version` is quick."""

__all__ = [
    "Config",
    "Estimates",
    "Innovations",
    "Log",
    "Result",
    "__version__",
    "load_config",
    "open_log",
    "read_result",
    "run",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACES[name]
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
