"""The filters: one file per algorithm, one line here each. They are imported when they are first asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Final

from mavins.errors import ConfigError
from mavins.filters.base import Filter, FilterState, ImuNoise, Observation, Outcome, RowBlock
from mavins.filters.settings import FilterSettings
from mavins.nav.layout import Layout

REGISTRY: Final = {
    "eskf": "mavins.filters.eskf:Eskf",
    "srcdkf": "mavins.filters.srcdkf:Srcdkf",
    "iekf": "mavins.filters.iekf:Iekf",
    "ieskf": "mavins.filters.ieskf:Ieskf",
    "euler_ekf": "mavins.filters.euler_ekf:EulerEkf",
}

WITHOUT_GRAVITY: Final = ("euler_ekf", "srcdkf")
"""Filters whose prediction has no error of gravity's direction."""


def make(
    name: str,
    noise: ImuNoise,
    layout: Layout | None = None,
    settings: FilterSettings | None = None,
) -> Filter:
    """The filter registered under `name`, by default with the 15 core states."""
    if name not in REGISTRY:
        raise ConfigError(f"unknown filter {name!r}; there are: {', '.join(sorted(REGISTRY))}")
    layout = layout or Layout.of()
    if layout.has_gravity and name in WITHOUT_GRAVITY:
        able = ", ".join(sorted(REGISTRY.keys() - WITHOUT_GRAVITY))
        raise ConfigError(
            f"states.gravity: the filter {name} cannot estimate gravity (block g_n); these can: {able}"
        )
    module, _, attribute = REGISTRY[name].partition(":")
    factory: Any = getattr(import_module(module), attribute)
    made: Filter = factory(noise, layout, settings or FilterSettings())
    return made


__all__ = [
    "REGISTRY",
    "Filter",
    "FilterSettings",
    "FilterState",
    "ImuNoise",
    "Observation",
    "Outcome",
    "RowBlock",
    "make",
]
