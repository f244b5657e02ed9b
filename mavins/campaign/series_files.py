"""A Monte-Carlo series as files and as lines for people.

`montecarlo.json` and `runs.csv` hold nothing that depends on who flew the runs; what does is in `timing.csv`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins import __version__
from mavins.campaign.montecarlo import QUANTITIES, Flown, Series, figures_of
from mavins.campaign.tables import cell, csv_text
from mavins.evaluation.compare import SETTLED_US
from mavins.results import write_json, write_text

FILES: Final = ("montecarlo.json", "runs.csv", "timing.csv", "montecarlo.png")


def by_filter(flown: Sequence[Flown]) -> dict[str, list[Flown]]:
    """The runs of each filter."""
    runs: dict[str, list[Flown]] = {}
    for one in flown:
        runs.setdefault(one.filter, []).append(one)
    return runs


def write_series(out: Path, name: str, series: Series, flown: Sequence[Flown]) -> dict[str, Any]:
    """Write the tables; returns the figures of each filter."""
    figures = {filter_name: figures_of(runs) for filter_name, runs in by_filter(flown).items()}
    write_text(out / "runs.csv", csv_text(_rows(flown)))
    write_text(out / "timing.csv", csv_text(_times(flown)))
    content = {
        "mavins": __version__,
        "scenario": name,
        "runs": series.runs,
        "duration_s": series.duration,
        "seed": series.seed,
        "settled_s": SETTLED_US * 1e-6,
        "vary": {spread.path: {spread.kind: list(spread.values)} for spread in series.spreads},
        "filters": figures,
    }
    write_json(out / "montecarlo.json", content)
    return figures


def _rows(flown: Sequence[Flown]) -> Iterator[dict[str, Any]]:
    aidings = sorted({name for f in flown for name in f.nis})
    for f in flown:
        row: dict[str, Any] = {"run": f.run, "seed": f.seed, "filter": f.filter, **f.drawn}
        row |= {"health": f.health, "resets": f.resets, "converged_s": cell(f.converged_s)}
        for kind, values in (("rms", f.rms), ("max", f.largest)):
            names = (f"{kind}_{quantity}" for quantity in QUANTITIES)
            row |= dict(zip(names, map(cell, values.tolist()), strict=True))
        row["nees"] = cell(float(np.mean(f.nees)) if len(f.nees) else np.nan)
        for name in aidings:
            total, rows = f.nis.get(name, (0.0, 0))
            row[f"nis_{name}"] = cell(total / rows if rows else np.nan)
        row["refused"] = sum(f.refused.values())
        row["reason"] = f.reason
        yield row


def _times(flown: Sequence[Flown]) -> Iterator[dict[str, Any]]:
    for f in flown:
        simulation, estimation = f"{f.simulation_cpu_s:.3f}", f"{f.filter_cpu_s:.3f}"
        yield {
            "run": f.run,
            "filter": f.filter,
            "simulation_cpu_s": simulation,
            "filter_cpu_s": estimation,
        }


def table_lines(figures: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """The figures side by side: 50 and 95 % of the errors, NEES, time to converge; then NIS of each filter."""
    units = [quantity.replace("_", " ", 1).replace("m_s", "m/s") for quantity in QUANTITIES]
    head = "".join(f"{unit:>16}" for unit in units)
    yield f"{'50 / 95 %':<11}{head}{'NEES (9)':>10}{'in band':>9}{'converged':>11}"
    for name, figure in figures.items():
        percentiles = figure["percentiles"]
        errors = "".join(f"{_pair(percentiles[quantity]):>16}" for quantity in QUANTITIES)
        nees, inside = figure.get("nees"), figure.get("nees_inside")
        shown = "-" if nees is None else f"{nees:.2f}"
        share = "-" if inside is None else f"{100 * inside:.0f} %"
        median = figure["convergence_s"]["50"]
        converged = "-" if median is None else f"{median:.1f} s"
        yield f"{name:<11}{errors}{shown:>10}{share:>9}{converged:>11}"
    bands = [figure["nees_band"] for figure in figures.values() if "nees_band" in figure]
    if bands:
        low, high = bands[0]
        yield f"NEES: 9 where the covariance is right; 95 % band {low:.2f} to {high:.2f}"
    for name, figure in figures.items():
        nis = ", ".join(
            f"{aiding} {n['mean']:.3f} ({n['band'][0]:.3f} to {n['band'][1]:.3f})"
            for aiding, n in figure["nis"].items()
        )
        yield f"{name}: NIS per row, and its 95 % band: {nis or 'none'}"
        trouble = {
            "ended " + health: n
            for health, n in figure["health"].items()
            if health not in ("running", "dead_reckoning")
        }
        trouble |= {"never converged": figure["never_converged"], "resets": figure["resets"]}
        for aiding, reasons in figure["refused"].items():
            trouble |= {f"{aiding} refused ({reason})": n for reason, n in reasons.items()}
        told = ", ".join(f"{n} {what}" for what, n in trouble.items() if n)
        if told:
            yield f"{name}: {told}"


def _pair(percentiles: Mapping[str, float | None]) -> str:
    middle, high = percentiles["50"], percentiles["95"]
    return "-" if middle is None or high is None else f"{middle:.3f} / {high:.3f}"


def pace_line(flown: Sequence[Flown], wall_s: float) -> str:
    """What the runs took."""
    runs = by_filter(flown)
    first = next(iter(runs.values()))
    parts = [f"simulation {np.mean([f.simulation_cpu_s for f in first]):.2f} s"]
    parts += [
        f"{name} {np.mean([f.filter_cpu_s for f in found]):.2f} s" for name, found in runs.items()
    ]
    pace = 60.0 * len(first) / wall_s
    return f"{len(first)} runs in {wall_s:.1f} s ({pace:.0f} a minute); CPU per run: {', '.join(parts)}"
