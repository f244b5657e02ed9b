"""Figures of the innovations: sequences with their gates, NIS against its band, whiteness."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from mavins.estimates import Innovations, Result
from mavins.estimator.gate import gate_threshold
from mavins.evaluation.findings_aiding import words
from mavins.evaluation.innovation_tests import autocorrelation, nis_band, running_mean
from mavins.report.drawing import (
    AXIS_COLORS,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    Figure,
    Panel,
    Series,
    band,
    dots,
    level,
    line,
    seconds,
)
from mavins.types import FloatArray

_WIDTH: Final = 50
"""Measurements of a running mean."""
_LAGS: Final = 40
_UNITS: Final = {
    "gnss_position": ("m", 1.0, ("north", "east", "down")),
    "gnss_velocity": ("m/s", 1.0, ("north", "east", "down")),
    "heading": ("deg", 180.0 / math.pi, ("yaw",)),
    "baro": ("m", 1.0, ("altitude",)),
    "magnetometer": ("share", 1.0, ("x", "y", "z")),
    "zero_velocity": ("m/s", 1.0, ("north", "east", "down")),
    "zero_rate": ("deg/s", 180.0 / math.pi, ("x", "y", "z")),
    "gravity_tilt": ("m/s²", 1.0, ("x", "y", "z")),
    "nonholonomic": ("m/s", 1.0, ("right", "down")),
}
_REFUSED: Final = (RED, PURPLE, ORANGE, BLACK)


def of_innovations(result: Result) -> Iterator[Figure]:
    """One figure per aiding, the NIS of all, and how white they are."""
    for name in sorted(result.innovations, key=lambda name: name.startswith("zero")):
        yield sequence(result, name, result.innovations[name])
    yield nis(result)
    yield whiteness(result)


def gate_of(result: Result, aiding: str) -> float:
    """The gate, in sigmas of one dimension."""
    section = "gnss" if aiding.startswith("gnss") else aiding
    section = "zero_velocity" if aiding == "zero_rate" else section
    return float(getattr(getattr(result.config, section, None), "gate", 5.0))


def sequence(result: Result, name: str, innovations: Innovations) -> Figure:
    """Innovations with 3 sigma, what was refused by its reason, and the NIS with its gate."""
    unit, scale, parts = _UNITS.get(name, ("", 1.0, ("0", "1", "2")))
    t = seconds(innovations.t_us)
    used = innovations.accepted
    reasons = sorted(set(innovations.reason[~used].tolist()))
    panels = []
    for i in range(innovations.innovation.shape[1]):
        r, sigma = scale * innovations.innovation[:, i], 3.0 * scale * innovations.sigma[:, i]
        known = np.isfinite(sigma)
        series = [
            band("3 sigma", t[known], -sigma[known], sigma[known]),
            dots("used", t[used], r[used], BLUE),
        ]
        series += _refused(innovations, reasons, r)
        panels.append(Panel(f"{parts[i] if i < len(parts) else i}, {unit}", tuple(series)))
    positive = np.maximum(innovations.nis, 1e-9)
    series = [dots("used", t[used], positive[used], BLUE)]
    series += _refused(innovations, reasons, positive)
    rows = int(np.isfinite(innovations.innovation).sum(axis=1).max(initial=1))
    series.append(level("gate", t, gate_threshold(gate_of(result, name), max(rows, 1)), RED))
    panels.append(Panel("NIS", tuple(series), log=True))
    return Figure(name, f"Innovations of {words(name)}", tuple(panels), height=170)


def _refused(innovations: Innovations, reasons: list[str], values: FloatArray) -> list[Series]:
    t = seconds(innovations.t_us)
    found = []
    for k, reason in enumerate(reasons):
        at = (innovations.reason == reason) & ~innovations.accepted
        color = _REFUSED[k % len(_REFUSED)]
        found.append(dots(f"refused: {reason}", t[at], values[at], color, "crosses"))
    return found


def nis(result: Result) -> Figure:
    """The mean NIS over a window per aiding, against the band that it should keep."""
    panels = []
    for name, innovations in result.innovations.items():
        m = innovations.select(innovations.accepted & np.isfinite(innovations.nis))
        width = min(_WIDTH, len(m) // 4)
        if width < 5:
            continue
        rows = int(np.isfinite(m.innovation).sum(axis=1).max())
        t = seconds(m.t_us[width - 1 :])
        low, high = nis_band(rows, width)
        ends = t[[0, -1]]
        panels.append(
            Panel(
                f"{words(name)}",
                (
                    band("95 % band", ends, np.full(2, low / rows), np.full(2, high / rows), GREEN),
                    line(
                        "running mean", t, np.maximum(running_mean(m.nis, width) / rows, 1e-9), BLUE
                    ),
                    level("1", t, 1.0, GREY),
                ),
                log=True,
            )
        )
    return Figure(
        "nis",
        "NIS per row against its band",
        tuple(panels),
        height=150,
        note=f"Means over {_WIDTH} measurements. 1 is right; below, the noises are set too large, above, too small.",
    )


def whiteness(result: Result) -> Figure:
    """The autocorrelation of normalized innovations with the band that holds 95 % of a white sequence's."""
    panels = []
    lags = np.arange(1.0, _LAGS + 1.0)
    for name, innovations in result.innovations.items():
        normalized = (innovations.innovation / innovations.sigma)[innovations.accepted]
        if len(normalized) < 3 * _LAGS:
            continue
        limit = 1.96 / math.sqrt(len(normalized))
        ends = np.array([1.0, float(_LAGS)])
        series = [band("95 % band", ends, np.full(2, -limit), np.full(2, limit), GREEN)]
        for i in range(normalized.shape[1]):
            values = normalized[np.isfinite(normalized[:, i]), i]
            if len(values) > _LAGS:
                part = f"component {i + 1}"
                series.append(line(part, lags, autocorrelation(values, _LAGS), AXIS_COLORS[i]))
        panels.append(Panel(words(name), tuple(series)))
    return Figure(
        "whiteness",
        "Whiteness: autocorrelation of the innovations",
        tuple(panels),
        "lag, measurements",
        "plain",
        height=150,
    )
