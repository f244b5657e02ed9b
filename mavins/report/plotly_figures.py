"""Figures as plotly.js takes them: plain dictionaries, arrays as base64 of their bytes.

plotly's own Python objects would check every attribute, for seconds; the page needs its script alone.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from mavins.report.drawing import BLACK, Figure, Series
from mavins.types import FloatArray

_TOP, _BOTTOM, _LEFT, _RIGHT, _BETWEEN = 44, 48, 84, 16, 16
"""Margins and the space between panels, in pixels."""
_GRID: Final = "#e4e8ec"


def plotly_figure(figure: Figure, extent: tuple[float, float] | None) -> dict[str, Any]:
    """`{key, time, data, layout}`; time figures begin with the horizontal `extent`."""
    data: list[dict[str, Any]] = []
    named: set[str] = set()
    for n, panel in enumerate(figure.panels):
        axis = "y" if n == 0 else f"y{n + 1}"
        for series in panel.series:
            for trace in _traces(series, figure.kind == "time"):
                legend = trace.pop("legend") and series.name not in named
                data.append(trace | {"yaxis": axis, "xaxis": "x", "showlegend": legend})
            named.add(series.name)
    time = figure.kind == "time"
    layout = _layout(figure, extent if time else None)
    return {"key": figure.key, "time": time, "data": data, "layout": layout}


def height(figure: Figure) -> int:
    """The pixels that a figure takes."""
    n = len(figure.panels)
    return _TOP + _BOTTOM + n * figure.height + (n - 1) * _BETWEEN


def _layout(figure: Figure, extent: tuple[float, float] | None) -> dict[str, Any]:
    n = len(figure.panels)
    inner = n * figure.height + (n - 1) * _BETWEEN
    axis = {
        "gridcolor": _GRID,
        "zerolinecolor": "#c8ced4",
        "linecolor": "#c8ced4",
        "ticks": "outside",
    }
    layout: dict[str, Any] = {
        "height": height(figure),
        "margin": {"t": _TOP, "b": _BOTTOM, "l": _LEFT, "r": _RIGHT},
        "font": {
            "family": "system-ui, Liberation Sans, Arial, sans-serif",
            "size": 12,
            "color": BLACK,
        },
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "hovermode": "closest" if figure.kind == "map" else "x unified",
        "hoversubplots": "axis",
        "hoverlabel": {"namelength": -1},
        "legend": {"orientation": "h", "x": 0, "y": 1 + 6 / inner, "yanchor": "bottom"},
        "dragmode": "zoom",
        "xaxis": axis
        | {
            "title": {"text": figure.x_label, "standoff": 8},
            "anchor": "y" if n == 1 else f"y{n}",
            "type": "log" if figure.x_log else "linear",
            "hoverformat": ".6~r",
        },
    }
    if extent is not None:
        layout["xaxis"] |= {"range": list(extent), "autorange": False}
    for k, panel in enumerate(figure.panels):
        top = 1.0 - k * (figure.height + _BETWEEN) / inner
        layout["yaxis" if k == 0 else f"yaxis{k + 1}"] = axis | {
            "domain": [max(0.0, top - figure.height / inner), top],
            "title": {"text": panel.label, "standoff": 6},
            "type": "log" if panel.log else "linear",
            "exponentformat": "power",
            "hoverformat": ".4~g",
            "rangemode": "tozero" if panel.from_zero else "normal",
            "nticks": max(4, figure.height // 35),
        }
    if figure.kind == "map":
        layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
        layout["legend"]["itemsizing"] = "constant"
    return layout


def _traces(series: Series, time: bool) -> Iterator[dict[str, Any]]:
    """A band is two: its lower edge, and the upper one filled down to it."""
    base: dict[str, Any] = {
        "type": "scatter",
        "name": series.name,
        "legendgroup": series.name,
        "x": _packed(series.x, np.float64 if time else np.float32),
        "legend": True,
    }
    if series.hidden:
        base["visible"] = "legendonly"
    match series.style:
        case "band":
            edge = base | {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
            yield edge | {"y": _packed(series.y), "legend": False}
            upper = series.y if series.upper is None else series.upper
            fill = {"fill": "tonexty", "fillcolor": _faint(series.color)}
            yield edge | {"y": _packed(upper)} | fill
        case "dots" | "crosses":
            symbol = "x" if series.style == "crosses" else "circle"
            size = 8 if series.style == "crosses" else 4
            marker = {"color": series.color, "symbol": symbol, "size": size}
            yield base | {"mode": "markers", "marker": marker, "y": _packed(series.y)}
        case _:
            line = {"color": series.color, "width": series.width}
            if series.dashed:
                line["dash"] = "dash"
            if series.style == "steps":
                line["shape"] = "hvh"
            yield base | {"mode": "lines", "line": line, "y": _packed(series.y)}


def _packed(values: FloatArray, kind: type[np.floating[Any]] = np.float32) -> dict[str, str]:
    little = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    name = "f8" if kind is np.float64 else "f4"
    return {"dtype": name, "bdata": base64.b64encode(little.tobytes()).decode("ascii")}


def _faint(color: str) -> str:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.22)"
