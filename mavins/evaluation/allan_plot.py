"""A picture of Allan deviations, which needs matplotlib (the extra 'report')."""

from __future__ import annotations

from pathlib import Path

from mavins.evaluation.allan import UNITS, Allan
from mavins.evaluation.pictures import plt


def draw_allan(path: Path, result: Allan) -> None:
    """Draw the deviations of gyro and accelerometer, and what was fitted to them, into a PNG."""
    figure, panels = plt.subplots(1, len(UNITS), figsize=(12, 5), constrained_layout=True)
    for panel, (sensor, units) in zip(panels, UNITS.items(), strict=True):
        for axis in result.of(sensor):
            (line,) = panel.loglog(axis.tau, axis.adev, ".", label=axis.name)
            panel.loglog(axis.tau, axis.fitted, color=line.get_color(), linewidth=1)
        panel.set(xlabel="tau, s", ylabel=f"Allan deviation of {sensor}, {units[1]}")
        panel.grid(True, which="both", alpha=0.3)
        panel.legend()
    figure.savefig(path)
    plt.close(figure)
