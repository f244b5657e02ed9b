"""Figures of the sensors: GNSS quality, spectrum and vibration of the IMU, rates, gaps and intervals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from mavins.estimates import Result
from mavins.evaluation.evidence import Evidence
from mavins.report.drawing import (
    AXIS_COLORS,
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    Figure,
    Panel,
    Series,
    dots,
    level,
    line,
    seconds,
)
from mavins.types import FloatArray, IntArray

_AXES: Final = ("x", "y", "z")


def of_sensors(result: Result) -> Iterator[Figure]:
    """All of them; none without evidence."""
    evidence = result.evidence
    if evidence is None:
        return
    yield gnss_quality(evidence)
    yield spectrum(result, evidence)
    yield vibration(evidence)
    yield rates(evidence)
    yield intervals(evidence)


def gnss_quality(evidence: Evidence) -> Figure:
    """What the receiver says of itself."""
    gnss = evidence.gnss
    t = seconds(gnss.t_us)
    claims = (("horizontal", BLUE), ("vertical", GREEN))
    accuracy = [line(n, t, gnss.sigmas[:, i], c) for i, (n, c) in enumerate(claims)]
    return Figure(
        "gnss_quality",
        "GNSS quality, as the receiver reports it",
        (
            Panel("accuracy, m", tuple(accuracy), from_zero=True),
            Panel("speed, m/s", (line("speed", t, gnss.sigmas[:, 2], ORANGE),), from_zero=True),
            Panel("satellites", (line("satellites", t, gnss.satellites, BLACK),), from_zero=True),
            Panel(
                "fix type",
                (line("fix type", t, gnss.fix_type.astype(np.float64), PURPLE),),
                from_zero=True,
            ),
        ),
        height=150,
        note="Fix types: 2 is 2-D, 3 is 3-D, 4 differential, 5 and 6 RTK.",
    )


def spectrum(result: Result, evidence: Evidence) -> Figure:
    """Root spectral densities against the noises that are set."""
    found = evidence.spectrum
    if found is None:
        return Figure("spectrum", "", ())
    root = np.sqrt(0.5 * found.psd)
    imu = result.config.imu
    panels = []
    for first, name, unit, setting in (
        (0, "gyro", "rad/s/√Hz", imu.gyro_noise),
        (3, "accel", "m/s²/√Hz", imu.accel_noise),
    ):
        series = [
            line(axis, found.frequency, root[:, first + i], AXIS_COLORS[i])
            for i, axis in enumerate(_AXES)
        ]
        series.append(level("setting", found.frequency, setting, RED))
        panels.append(Panel(f"{name}, {unit}", tuple(series), log=True))
    return Figure(
        "spectrum",
        "Vibration spectrum of the IMU",
        tuple(panels),
        "frequency, Hz",
        "plain",
        x_log=True,
        height=250,
        note=f"Mean over {found.segments} segments of a log at {found.rate:.0f} Hz, along the sensor's axes.",
    )


def vibration(evidence: Evidence) -> Figure:
    """The spread within each second, and samples at the accelerometer's limit."""
    imu = evidence.imu
    t = seconds(imu.t_us)
    gyro = [
        line(axis, t, np.degrees(imu.spread[:, i]), AXIS_COLORS[i]) for i, axis in enumerate(_AXES)
    ]
    accel = [line(axis, t, imu.spread[:, 3 + i], AXIS_COLORS[i]) for i, axis in enumerate(_AXES)]
    panels = [Panel("gyro, deg/s", tuple(gyro)), Panel("accel, m/s²", tuple(accel))]
    if imu.clipped.any():
        clipped = line("at its limit", t, imu.clipped.astype(np.float64), RED)
        panels.append(Panel("at its limit, 1/s", (clipped,)))
    return Figure(
        "vibration", "Motion and vibration: standard deviation within a second", tuple(panels)
    )


def rates(evidence: Evidence) -> Figure:
    """How many readings a second, and the longest interval in it."""
    imu = evidence.imu
    t = seconds(imu.t_us)
    inside = slice(1, -1) if len(t) > 2 else slice(None)  # the ends are parts of a second
    first = line("IMU", t[inside], imu.count[inside].astype(np.float64), BLUE)
    longest = [line("IMU", t, 1e3 * seconds(imu.longest_us), BLUE)]
    others: list[Series] = []
    for name, t_us, color in (
        ("GNSS", evidence.gnss.t_us, ORANGE),
        ("heading", evidence.heading_us, GREEN),
        ("magnetometer", evidence.mag_us, PURPLE),
        ("barometer", evidence.baro_us, BLACK),
    ):
        if len(t_us) < 3:
            continue
        others.append(line(name, *_per_second(t_us), color))
        steps = 1e-3 * np.diff(t_us)
        longest.append(dots(name, seconds(t_us[1:]), np.maximum(steps, 1e-3), color))
    return Figure(
        "rates",
        "Rates and gaps of the sensors",
        (
            Panel("IMU, Hz", (first,), from_zero=True),
            Panel("others, Hz", tuple(others), from_zero=True),
            Panel("interval, ms", tuple(longest), log=True),
        ),
        note="Of the IMU the longest interval of each second; of the others every one.",
    )


def _per_second(t_us: IntArray) -> tuple[FloatArray, FloatArray]:
    second = t_us // 1_000_000
    first, last = int(second.min()), int(second.max())
    if last - first > 200_000:  # a clock that jumped: no line to draw
        return np.empty(0), np.empty(0)
    counts = np.bincount(second - first, minlength=last - first + 1).astype(np.float64)
    return np.arange(first, last + 1.0)[1:-1], counts[1:-1]


def intervals(evidence: Evidence) -> Figure:
    """How often the IMU's samples were how far apart."""
    counts = evidence.imu.intervals
    used = np.flatnonzero(counts)
    if not len(used):
        return Figure("intervals", "", ())
    at = np.arange(max(used[0] - 2, 0), min(used[-1] + 3, len(counts)))
    bars = Series("intervals", 0.1 * at, np.maximum(counts[at], 0.5), BLUE, "steps")
    return Figure(
        "intervals",
        "Intervals between IMU samples",
        (Panel("how many", (bars,), log=True),),
        "interval, ms",
        "plain",
        height=240,
        note="The last step has all of 200 ms and more." if used[-1] == len(counts) - 1 else "",
    )
