"""Three real flights, two recorded as CSV and a PX4 .ulg, through every filter; differences to the log's own filter.

The limits are sanity limits: the reference is another filter on the same sensors, not a truth.
Tutorial: docs/tutorials/flights.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins.config import load
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.settings import Settings
from mavins.estimator.solution import EULER, LLA, V_L, WIDTH, describe
from mavins.evaluation.errors import Errors, errors_against
from mavins.examples.base import Figure, needed
from mavins.filters import REGISTRY, RowBlock
from mavins.logs.content import kind_of
from mavins.logs.feeding import feed_log, settled
from mavins.logs.sensor_log import SensorLog
from mavins.nav.earth import TangentFrame
from mavins.results import write_json
from mavins.sources import read_sensors
from mavins.types import FloatArray, Health, IntArray

GRID_US: Final = 100_000
UNITS: Final = {"pos_m": "m", "vel_m_s": "m/s", "att_deg": "deg"}


@dataclass(frozen=True, slots=True)
class Flight:
    """A recorded flight: its settings, above which speed (m/s) it is judged, and its limits per quantity and axis.

    `span` bounds what is judged, in s on the vehicle's clock.
    """

    name: str
    settings: dict[str, Any]
    min_speed: float
    limits: dict[str, tuple[float, float, float]]
    span: tuple[float, float] = (0.0, math.inf)


FLIGHTS: Final = (
    Flight(
        "fixedwing_umn_thor75",
        # the receiver gives 3-D fixes with four satellites, and this flight has a hundred of them
        {"gnss.min_satellites": 4, "magnetometer.date": 2012.5},
        8.0,
        {"pos_m": (5.0, 5.0, 5.0), "vel_m_s": (1.0, 1.0, 1.0), "att_deg": (2.0, 2.0, 5.0)},
    ),
    Flight(
        "quad_apm_122a",
        {"magnetometer.date": 2013.5},
        0.0,
        # in single turns the reference's yaw departs from the gyros by 20 deg
        {"att_deg": (2.0, 2.0, 20.0)},
    ),
    Flight(
        "quad_px4_mr_tropic.ulg.xz",
        {"magnetometer.date": 2025.1},
        0.0,
        # its accelerometer clips in flight, and what its own filter put out differs from that filter's states
        {"pos_m": (1.5, 1.5, 1.5), "vel_m_s": (0.8, 0.8, 0.8), "att_deg": (3.0, 3.0, 6.0)},
        (60.0, 112.0),
    ),
)


class _Rows:
    """Estimates as the estimator hands them over."""

    def __init__(self) -> None:
        self._t: list[IntArray] = [np.empty(0, dtype=np.int64)]
        self._rows: list[FloatArray] = [np.empty((0, WIDTH))]

    def take(self, block: RowBlock, frame: TangentFrame) -> None:
        n = block.count
        rows = np.empty((n, WIDTH))
        describe(block.x[:n], block.P[:n], frame.r0_e, frame.C_ne, rows)
        self._t.append(block.t_us[:n].copy())
        self._rows.append(rows)

    def table(self) -> tuple[IntArray, FloatArray]:
        return np.concatenate(self._t), np.concatenate(self._rows)


def fly(log: SensorLog, settings: Settings, name: str, flight: Flight) -> tuple[Errors, str]:
    """One filter through one flight: differences to its reference, and what went wrong, if anything."""
    kept = _Rows()
    estimator = Estimator(settings, name, Outputs(GRID_US, kept.take))
    feed_log(log, estimator, settings, lambda _: None)
    estimator.finish()
    t_us, rows = kept.table()
    judged = np.hypot(rows[:, 6], rows[:, 7]) >= flight.min_speed
    judged &= (t_us >= flight.span[0] * 1e6) & (t_us <= flight.span[1] * 1e6)
    t_us, rows = t_us[judged], rows[judged]
    truth = log.reference
    assert truth is not None
    errors = errors_against(t_us, rows[:, LLA], rows[:, V_L], rows[:, EULER], truth.columns())
    trouble = estimator.loss
    if math.isfinite(flight.span[1]):
        return errors, trouble  # what becomes of it after a crash is not judged
    if estimator.health is not Health.RUNNING:
        trouble = f"{estimator.health.name.lower()}: {estimator.reason}"
    return errors, trouble


def run(data: Path | None, out: Path | None, say: Callable[[str], None]) -> Sequence[Figure]:
    """Every registered filter through all flights."""
    figures: list[Figure] = []
    tables: dict[str, Any] = {}
    for flight in FLIGHTS:
        path = needed(data, "flights", flight.name)
        log = read_sensors(path, kind_of(path))
        settings = settled(load(None, flight.settings), log)
        mag = settings.magnetometer
        say(f"{flight.name}: {log.seconds:.0f} s, {log.counts}")
        say(f"  magnetometer found to be turned by {mag.rotation} rad, hard iron {mag.hard_iron}")
        table = tables[flight.name] = {}
        for name in REGISTRY:
            errors, trouble = fly(log, settings, name, flight)
            table[name] = {**errors.summary(), "trouble": trouble}
            say(f"  {name:<10} {_line(table[name])}{trouble and f', {trouble}'}")
            figures += _judged(flight, name, table[name])
    if out is not None:
        write_json(out / "flights.json", tables)
    return figures


def _line(summary: dict[str, Any]) -> str:
    """RMS differences as a line of text."""
    words = {"pos_m": "N/E/D", "vel_m_s": "N/E/D", "att_deg": "roll/pitch/yaw"}
    return ", ".join(
        f"{words[key]} {'/'.join(f'{value:.2f}' for value in values)} {UNITS[key]}"
        for key, values in summary.get("rms", {}).items()
    )


def _judged(flight: Flight, name: str, summary: dict[str, Any]) -> list[Figure]:
    """The worst share of its limit for each quantity, and that the filter ran through."""
    label = f"{flight.name}, {name}"
    figures = [Figure(f"{label}: began anew or ended lost", float(bool(summary["trouble"])), 0.0)]
    for key, limits in flight.limits.items():
        values = summary.get("rms", {}).get(key, [np.nan] * 3)
        for axis, value, limit in zip(_AXES[key], values, limits, strict=True):
            figures.append(Figure(f"{label}: {axis}, RMS difference", value, limit, UNITS[key]))
    return figures


_AXES: Final = {
    "pos_m": ("north", "east", "down"),
    "vel_m_s": ("velocity north", "velocity east", "velocity down"),
    "att_deg": ("roll", "pitch", "yaw"),
}
