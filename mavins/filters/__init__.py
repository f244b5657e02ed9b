"""The filters: one file per algorithm, one line here each. They are imported when they are first asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Final

from mavins.errors import ConfigError
from mavins.filters.base import Filter, FilterState, ImuNoise, RowBlock

REGISTRY: Final = {
    "eskf": "mavins.filters.eskf:Eskf",
}


def make(name: str, noise: ImuNoise) -> Filter:
    """The filter registered under `name`."""
    if name not in REGISTRY:
        raise ConfigError(f"unknown filter {name!r}; there are: {', '.join(sorted(REGISTRY))}")
    module, _, attribute = REGISTRY[name].partition(":")
    factory: Any = getattr(import_module(module), attribute)
    made: Filter = factory(noise)
    return made


__all__ = ["REGISTRY", "Filter", "FilterState", "ImuNoise", "RowBlock", "make"]
