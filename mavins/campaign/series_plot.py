"""A Monte-Carlo series as one figure: NEES beside its band, errors over time, and over what was varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mavins.campaign.montecarlo import QUANTITIES, Flown
from mavins.evaluation.compare import DOF, SECOND_US, mean_nees
from mavins.evaluation.consistency import band
from mavins.evaluation.pictures import plt
from mavins.types import FloatArray

_SHOWN = ("horizontal_m", "vertical_m", "yaw_deg")
_ACROSS = 3


def draw_series(path: Path, runs: Mapping[str, Sequence[Flown]]) -> None:
    """Draw the runs of each filter into a PNG."""
    first = next(iter(runs.values()))
    varied = [name for name, value in first[0].drawn.items() if isinstance(value, int | float)]
    rows = 2 + -(-len(varied) // _ACROSS)
    figure, axes = plt.subplots(
        rows, _ACROSS, figsize=(16, 4.2 * rows), constrained_layout=True, squeeze=False
    )
    panels = axes.ravel().tolist()
    for k, (name, flown) in enumerate(runs.items()):
        color = f"C{k}"
        _draw_nees(panels[0], name, flown, color)
        for panel, quantity in zip(panels[1:4], _SHOWN, strict=True):
            _draw_errors(panel, name, flown, QUANTITIES.index(quantity), color)
        rms = np.sort([f.rms[0] for f in flown])
        panels[4].plot(rms, np.linspace(0, 100, len(rms)), color=color, label=name)
        converged = np.sort([f.converged_s for f in flown])
        panels[5].plot(converged, np.linspace(0, 100, len(rms)), color=color, label=name)
        for panel, parameter in zip(panels[6:], varied, strict=False):
            values = [f.drawn[parameter] for f in flown]
            panel.plot(values, [f.rms[0] for f in flown], ".", color=color, label=name)
            panel.set(xlabel=parameter, ylabel="horizontal RMS, m")
    low, high = band(DOF, len(first))
    panels[0].axhspan(low, high, alpha=0.15, color="k", label="95 % band")
    panels[0].set(xlabel="time since boot, s", ylabel="mean NEES (9)")
    for panel, quantity in zip(panels[1:4], _SHOWN, strict=True):
        panel.set(xlabel="time since boot, s", ylabel=f"{quantity}: 50 and 95 % of the runs")
        panel.set_yscale("log")
    panels[4].set(xlabel="horizontal RMS, m", ylabel="% of the runs")
    panels[5].set(xlabel="converged after, s", ylabel="% of the runs")
    for panel in panels[6 + len(varied) :]:
        panel.remove()
    for panel in panels[: 6 + len(varied)]:
        panel.grid(alpha=0.3)
    panels[0].legend()
    aside = path.with_name(path.name + ".part")
    # a picture of the same numbers is the same bytes
    figure.savefig(aside, dpi=100, format="png", metadata={"Software": None})
    aside.replace(path)
    plt.close(figure)


def _draw_nees(panel: Any, name: str, flown: Sequence[Flown], color: str) -> None:
    seconds, mean = mean_nees([(f.nees_us, f.nees) for f in flown])
    panel.plot(seconds, mean, color=color, label=name, linewidth=0.8)


def _draw_errors(panel: Any, name: str, flown: Sequence[Flown], column: int, color: str) -> None:
    """Percentiles over the runs at the seconds that any of them has."""
    seconds = np.unique(np.concatenate([f.t_us // SECOND_US for f in flown]))
    table: FloatArray = np.full((len(flown), len(seconds)), np.nan)
    for row, f in zip(table, flown, strict=True):
        row[np.searchsorted(seconds, f.t_us // SECOND_US)] = f.sizes[:, column]
    known = np.isfinite(table).any(axis=0)
    if known.any():
        middle, high = np.nanpercentile(table[:, known], (50.0, 95.0), axis=0)
        panel.plot(seconds[known], middle, color=color, label=name)
        panel.plot(seconds[known], high, color=color, linewidth=0.8, linestyle="--")
