"""An observability analysis as one figure: singular values by segment, and each state's sigma over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mavins.evaluation.observability import VISIBLE, Analysis
from mavins.evaluation.pictures import plt

_FLOOR = 1e-12
"""What is smaller is drawn as this."""


def draw_analysis(path: Path, analysis: Analysis) -> None:
    """Draw an analysis into a PNG."""
    segments, states = analysis.segments, analysis.states
    blocks = list(dict.fromkeys(name.partition(".")[0] for name in states))
    rows = 1 + (len(blocks) + 1) // 2
    figure = plt.figure(figsize=(14, 3.6 * rows), constrained_layout=True)
    grid = figure.add_gridspec(rows, 2)
    begin_us = segments[0].start_us
    edges = [(s.start_us - begin_us) * 1e-6 for s in segments]
    edges.append((segments[-1].end_us - begin_us) * 1e-6)
    top = figure.add_subplot(grid[0, :])
    values = np.maximum([s.values for s in segments], _FLOOR)
    for column in values.T:
        top.stairs(column, edges, baseline=None, color="tab:blue", alpha=0.6)
    for s, left in zip(segments, edges, strict=False):
        top.text(left, values.max(), f" {s.label}", rotation=90, va="top", fontsize=7)
    top.axhline(1.0, color="black", linewidth=0.8)
    top.set(yscale="log", xlim=(0, edges[-1]), xlabel="time, s", title="each segment by itself")
    top.set_ylabel("information per prior variance")
    t = (analysis.t_us - begin_us) * 1e-6
    for place, block in enumerate(blocks):
        panel = figure.add_subplot(grid[1 + place // 2, place % 2])
        for i, name in enumerate(states):
            if name.partition(".")[0] == block:
                panel.plot(t, analysis.ratios[:, i], label=name)
        panel.axhline(VISIBLE, color="black", linewidth=0.8, linestyle=":")
        panel.set(yscale="log", xlim=(0, edges[-1]), xlabel="time, s", ylabel="sigma / prior sigma")
        panel.grid(alpha=0.3)
        panel.legend(loc="lower left")
    figure.savefig(path, dpi=110)
    plt.close(figure)
