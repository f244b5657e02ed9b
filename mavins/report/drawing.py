"""What is drawn, before anyone draws it: figures of stacked panels of series, as arrays in the units of their labels.

A page and the PNGs are made from the same figures. Lines are thinned so that every peak stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from mavins.types import FloatArray, IntArray

Style = Literal["line", "dots", "crosses", "band", "steps"]
Kind = Literal["time", "plain", "map"]

POINTS: Final = 4_000
"""Of a line, at the most."""

BLACK: Final = "#1b1f24"
GREY: Final = "#8a929c"
BLUE: Final = "#1f75fe"
ORANGE: Final = "#e07b00"
GREEN: Final = "#1d8a4a"
RED: Final = "#d1242f"
PINK: Final = "#d6277f"
PURPLE: Final = "#8250df"
AXIS_COLORS: Final = (BLUE, GREEN, ORANGE)


@dataclass(frozen=True, slots=True)
class Series:
    """One thing drawn: `x`, `y` (N,); a band fills from `y` up to `upper`. Series of one name share a legend entry."""

    name: str
    x: FloatArray
    y: FloatArray
    color: str
    style: Style = "line"
    upper: FloatArray | None = None
    width: float = 1.4
    dashed: bool = False
    hidden: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes: its vertical label with the unit, and what is in it."""

    label: str
    series: tuple[Series, ...]
    log: bool = False
    from_zero: bool = False


@dataclass(frozen=True, slots=True)
class Figure:
    """Panels above each other over one horizontal axis; `key` is its name in links and files."""

    key: str
    title: str
    panels: tuple[Panel, ...]
    x_label: str = "time on the vehicle's clock, s"
    kind: Kind = "time"
    x_log: bool = False
    note: str = ""
    height: int = 200

    def filled(self) -> Figure | None:
        """The figure without the series and panels that have nothing to show; None where none is left."""
        panels = []
        for panel in self.panels:
            series = tuple(s for s in panel.series if _shows(s, panel.log))
            if any(s.style != "band" and not s.dashed for s in series):
                panels.append(replace(panel, series=series))
        if not panels:
            return None
        return replace(self, panels=tuple(panels))


def _shows(series: Series, log: bool) -> bool:
    shown = np.isfinite(series.x) & np.isfinite(series.y)
    return bool((shown & (series.y > 0.0) if log else shown).any())


def seconds(t_us: IntArray) -> FloatArray:
    """Microseconds as seconds."""
    return np.multiply(t_us, 1e-6, dtype=np.float64)


def line(
    name: str,
    x: FloatArray,
    y: FloatArray,
    color: str,
    width: float = 1.4,
    dashed: bool = False,
    hidden: bool = False,
) -> Series:
    """A thinned line."""
    x, y = thin(x, y)
    return Series(name, x, y, color, width=width, dashed=dashed, hidden=hidden)


def dots(
    name: str, x: FloatArray, y: FloatArray, color: str, style: Style = "dots", hidden: bool = False
) -> Series:
    """Thinned points."""
    x, y = thin(x, y)
    return Series(name, x, y, color, style, hidden=hidden)


def band(name: str, x: FloatArray, low: FloatArray, high: FloatArray, color: str = GREY) -> Series:
    """A thinned band, never narrower than it is."""
    if len(x) > POINTS // 2:
        edges = _edges(len(x), POINTS // 2)
        low, high = np.fmin.reduceat(low, edges), np.fmax.reduceat(high, edges)
        x = x[edges]
    return Series(name, x, low, color, "band", high, width=0.0)


def level(name: str, x: FloatArray, y: float, color: str = GREY) -> Series:
    """A dashed horizontal line over the extent of x."""
    ends = np.array([np.nanmin(x), np.nanmax(x)])
    return Series(name, ends, np.full(2, y), color, width=1.0, dashed=True)


def thin(x: FloatArray, y: FloatArray, points: int = POINTS) -> tuple[FloatArray, FloatArray]:
    """At most so many of the points (N,), among them the smallest and the largest of each stretch, and the ends."""
    if len(x) <= points:
        return x, y
    edges = _edges(len(x), points // 2 - 1)
    lengths = np.diff(np.append(edges, len(x)))
    pad = int(lengths.max())
    at = np.minimum(edges[:, None] + np.arange(pad), (edges + lengths - 1)[:, None])
    block = y[at]
    known = np.isfinite(block)
    low = at[np.arange(len(at)), np.argmin(np.where(known, block, np.inf), axis=1)]
    high = at[np.arange(len(at)), np.argmax(np.where(known, block, -np.inf), axis=1)]
    kept = np.unique(np.concatenate([[0], low, high, [len(x) - 1]]))
    return x[kept], y[kept]


def _edges(n: int, stretches: int) -> IntArray:
    edges: IntArray = np.unique(np.linspace(0, n, stretches, endpoint=False).astype(np.int64))
    return edges
