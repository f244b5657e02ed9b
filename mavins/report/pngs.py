"""The report's figures as PNG files, by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from mavins.errors import OutputError
from mavins.evaluation.pictures import plt
from mavins.report.drawing import Figure, Series

_WIDTH_IN: Final = 12.0
_PIXELS_PER_INCH: Final = 90.0


def write_png(path: Path, figure: Figure) -> None:
    """Draw one figure into a file. Raises OutputError."""
    n = len(figure.panels)
    size = (_WIDTH_IN, 0.9 + n * figure.height / _PIXELS_PER_INCH)
    drawing, axes = plt.subplots(
        n, 1, figsize=size, sharex=True, squeeze=False, constrained_layout=True
    )
    entries: dict[str, Any] = {}
    for ax, panel in zip(axes[:, 0], figure.panels, strict=True):
        for series in panel.series:
            entries.setdefault(series.name, _draw(ax, series))
        ax.set_ylabel(panel.label)
        ax.set_yscale("log" if panel.log else "linear")
        ax.grid(alpha=0.3)
    last = axes[-1, 0]
    last.set_xlabel(figure.x_label)
    if figure.x_log:
        last.set_xscale("log")
    if figure.kind == "map":
        last.set_aspect("equal", adjustable="datalim")
    drawing.suptitle(figure.title)
    drawing.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=6)
    try:
        drawing.savefig(path, dpi=100)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    finally:
        plt.close(drawing)


def _draw(ax: Any, series: Series) -> Any:
    match series.style:
        case "band":
            return ax.fill_between(
                series.x, series.y, series.upper, color=series.color, alpha=0.22, linewidth=0
            )
        case "dots" | "crosses":
            marker = "x" if series.style == "crosses" else "."
            return ax.plot(series.x, series.y, marker, color=series.color, markersize=4)[0]
        case "steps":
            return ax.step(series.x, series.y, color=series.color, where="mid")[0]
        case _:
            style = "--" if series.dashed else "-"
            return ax.plot(series.x, series.y, style, color=series.color, linewidth=series.width)[0]
