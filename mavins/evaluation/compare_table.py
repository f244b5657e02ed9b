"""A comparison of filters as lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def table_lines(figures: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """One table: RMS, below it the largest error, NEES, time to converge and CPU; then NIS per aiding."""
    head = f"{'filter':<10}{'pos N/E/D m':>22}{'vel N/E/D m/s':>22}{'roll/pitch/yaw deg':>22}"
    yield f"{head}{'NEES (9)':>10}{'in band':>9}{'converged':>11}{'CPU/IMU':>10}"
    for name, figure in figures.items():
        inside = figure.get("nees_inside")
        cells = [
            f"{name:<10}",
            *(f"{_axes(figure, 'rms', part):>22}" for part in ("pos", "vel", "att")),
            f"{_number(figure.get('nees'), '.2f'):>10}",
            f"{'-' if inside is None else f'{100 * inside:.0f} %':>9}",
            f"{_number(figure.get('convergence_s'), '.1f', ' s'):>11}",
            f"{figure['cpu_us']:>7.1f} us",
        ]
        yield "".join(cells)
        if "max" in figure:
            largest = "".join(f"{_axes(figure, 'max', part):>22}" for part in ("pos", "vel", "att"))
            yield f"{'  largest':<10}{largest}"
    bands = [figure["nees_band"] for figure in figures.values() if "nees_band" in figure]
    if bands:
        yield f"NEES: 9 where the covariance is right; 95 % band {bands[0][0]:.2f} to {bands[0][1]:.2f}"
    for name, figure in figures.items():
        nis = ", ".join(f"{a} {_number(v, '.2f')}" for a, v in figure["nis"].items()) or "none"
        trouble = [h for h in figure["health"] if h not in ("running", "dead_reckoning")]
        yield (
            f"{name}: NIS per row (1 where the noise is right): {nis}"
            + (f"; ended {', '.join(trouble)}" if trouble else "")
            + (f"; {figure['resets']} resets" if figure["resets"] else "")
        )


def _axes(figure: Mapping[str, Any], kind: str, part: str) -> str:
    return "/".join(f"{v:.3f}" for v in figure[kind][part]) if part in figure.get(kind, {}) else "-"


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None or value != value else f"{value:{form}}{unit}"
