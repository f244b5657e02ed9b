"""Figures of the estimate: track, altitude and speed, attitude, errors with their bands, biases and further states."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from mavins.estimates import Result
from mavins.nav.earth import SEMI_MAJOR
from mavins.nav.so3 import quat_to_euler
from mavins.report.drawing import (
    AXIS_COLORS,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    Figure,
    Panel,
    Series,
    band,
    dots,
    level,
    line,
    seconds,
    thin,
)
from mavins.types import FloatArray

DEG: Final = 180.0 / np.pi
_ELLIPSES: Final = 30
_NED: Final = ("north", "east", "down")
_EULER: Final = ("roll", "pitch", "yaw")
_BAND: Final = "3 sigma"
_JUMP_DEG: Final = 180.0


def of_estimate(result: Result) -> Iterator[Figure]:
    """All figures of this kind; those that have nothing to show are left out by who draws them."""
    yield track(result)
    if len(result):
        yield motion(result)
        yield attitude(result)
        yield from errors(result)
        yield from states(result)


def _others(
    result: Result,
) -> Iterator[tuple[str, str, bool, FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Truth and reference: name, color, dashed, t, lla, v_l, q_lb."""
    for truth, word, color in (
        (result.truth, "truth", BLACK),
        (result.reference, "reference", PINK),
    ):
        if truth is not None:
            yield (
                word,
                color,
                word == "reference",
                seconds(truth.t_us),
                truth.lla,
                truth.v_l,
                truth.q_lb,
            )


def _north_east(lla: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Metres north and east of a place, for drawing: right to a thousandth over tens of kilometres."""
    east = np.remainder(lla[:, 1] - origin[1] + np.pi, 2.0 * np.pi) - np.pi
    return (lla[:, 0] - origin[0]) * SEMI_MAJOR, east * SEMI_MAJOR * np.cos(origin[0])


def track(result: Result) -> Figure:
    """North over east with equal scales, and ellipses of 3 sigma now and then."""
    series: list[Series] = []
    e, evidence = result, result.evidence
    usable = None
    if evidence is not None:
        usable = evidence.gnss.lla[evidence.gnss.fix_type >= 2]
    origin = e.lla[0] if len(e) else usable[0] if usable is not None and len(usable) else None
    if origin is None:
        return Figure("track", "Track", ())
    if usable is not None and len(usable):
        north, east = _north_east(usable[np.r_[: len(usable) : _stride(len(usable))]], origin)
        series.append(Series("GNSS", east, north, ORANGE, "dots"))
    for name, color, dashed, _, lla, _, _ in _others(result):
        north, east = _north_east(lla[:: _stride(len(lla))], origin)
        series.append(Series(name, east, north, color, width=3.0, dashed=dashed))
    if len(e):
        north, east = _north_east(e.lla[:: _stride(len(e))], origin)
        series.append(Series("estimate", east, north, BLUE))
        series.append(_ellipses(result, origin))
        north, east = _north_east(e.lla[[0, -1]], origin)
        series.append(Series("start", east[:1], north[:1], GREEN, "crosses"))
    return Figure(
        "track",
        "Track",
        (Panel("north, m", tuple(series)),),
        "east, m",
        "map",
        height=560,
        note="Ellipses are 3 sigma of the position, at even intervals of time.",
    )


def _stride(n: int) -> int:
    return max(1, n // 4_000)


def _ellipses(result: Result, origin: FloatArray) -> Series:
    """One series of closed curves with gaps between them."""
    e = result
    k = np.unique(np.linspace(0, len(e) - 1, _ELLIPSES).astype(np.int64))
    north, east = _north_east(e.lla[k], origin)
    turn = np.append(np.linspace(0.0, 2.0 * np.pi, 25), np.nan)
    sd = 3.0 * e.sd_p_n[k]
    x = east[:, None] + sd[:, 1:2] * np.cos(turn)
    y = north[:, None] + sd[:, 0:1] * np.sin(turn)
    return Series(_BAND, x.ravel(), y.ravel(), GREY, width=0.8)


def motion(result: Result) -> Figure:
    """Altitude, speed over ground, vertical speed."""
    e = result
    altitude, ground, climb = [], [], []
    if result.evidence is not None and len(result.evidence.gnss.t_us):
        gnss = result.evidence.gnss
        known = gnss.fix_type >= 2
        t = seconds(gnss.t_us[known])
        v = gnss.v_l[known]
        altitude.append(dots("GNSS", t, gnss.lla[known, 2], ORANGE))
        ground.append(dots("GNSS", t, np.hypot(v[:, 0], v[:, 1]), ORANGE))
        climb.append(dots("GNSS", t, -v[:, 2], ORANGE))
    for name, color, dashed, t, lla, v, _ in _others(result):
        altitude.append(line(name, t, lla[:, 2], color, 3.0, dashed))
        ground.append(line(name, t, np.hypot(v[:, 0], v[:, 1]), color, 3.0, dashed))
        climb.append(line(name, t, -v[:, 2], color, 3.0, dashed))
    v = e.v
    altitude.append(line("estimate", e.seconds, e.lla[:, 2], BLUE))
    ground.append(line("estimate", e.seconds, np.hypot(v[:, 0], v[:, 1]), BLUE))
    climb.append(line("estimate", e.seconds, -v[:, 2], BLUE))
    return Figure(
        "motion",
        "Altitude and speed",
        (
            Panel("altitude, m", tuple(altitude)),
            Panel("ground speed, m/s", tuple(ground)),
            Panel("climb, m/s", tuple(climb)),
        ),
    )


def attitude(result: Result) -> Figure:
    """Roll, pitch and yaw; headings beside the yaw."""
    e = result
    panels: list[list[Series]] = [[], [], []]
    if result.evidence is not None and len(result.evidence.yaw):
        yaw = np.remainder(result.evidence.yaw * DEG + 180.0, 360.0) - 180.0
        panels[2].append(dots("heading", seconds(result.evidence.heading_us), yaw, ORANGE))
    for name, color, dashed, t, _, _, q in _others(result):
        t, q = t[:: _stride(len(t))], q[:: _stride(len(q))]
        euler = np.array([quat_to_euler(one) for one in q]).reshape(-1, 3) * DEG
        for i in range(3):
            panels[i].append(
                Series(name, *_unbroken(t, euler[:, i]), color, width=3.0, dashed=dashed)
            )
    for i in range(3):
        x, y = thin(e.seconds, e.euler[:, i] * DEG)
        panels[i].append(Series("estimate", *_unbroken(x, y), BLUE))
    named = tuple(Panel(f"{n}, deg", tuple(s)) for n, s in zip(_EULER, panels, strict=True))
    return Figure("attitude", "Attitude", named)


def _unbroken(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A line that is parted where an angle goes from one end of the circle to the other."""
    at = np.flatnonzero(abs(np.diff(y)) > _JUMP_DEG) + 1
    return np.insert(x, at, np.nan), np.insert(y, at, np.nan)


def errors(result: Result) -> Iterator[Figure]:
    """Errors inside their 3 sigma; without anything to compare to, the sigmas alone."""
    e, found = result, result.errors
    kinds = (
        ("position", "m", _NED, e.sd_p_n, 1.0, None if found is None else found.pos),
        ("velocity", "m/s", _NED, e.sd_v, 1.0, None if found is None else found.vel),
        ("attitude", "deg", _EULER, e.sd_euler, DEG, None if found is None else found.att),
    )
    for kind, unit, names, sigma, scale, error in kinds:
        judged = error is not None and bool(np.isfinite(error).any())
        panels = []
        for i, name in enumerate(names):
            s = 3.0 * scale * sigma[:, i]
            if found is None or error is None or not judged:
                series: tuple[Series, ...] = (line(_BAND, e.seconds, s, BLUE),)
            else:
                word = f"estimate - {'truth' if result.is_true else 'reference'}"
                series = (
                    band(_BAND, e.seconds, -s, s),
                    line(word, seconds(found.t_us), scale * error[:, i], BLUE),
                )
            panels.append(Panel(f"{name}, {unit}", series))
        title = _title(kind, result if judged else None)
        yield Figure(f"error_{kind}", title, tuple(panels), height=170)


def _title(kind: str, judged: Result | None) -> str:
    source = "" if judged is None or judged.judge is None else judged.judge.source
    if judged is None:
        return f"{kind.capitalize()}, 3 sigma of the estimate"
    if judged.is_true:
        return f"{kind.capitalize()} error against {source}"
    return f"{kind.capitalize()} difference to {source}"


def states(result: Result) -> Iterator[Figure]:
    """Biases, and whatever else is estimated, with bands of 3 sigma."""
    t, xyz = result.seconds, ("x", "y", "z")
    arm = result.config.gnss.lever_arm
    groups: tuple[tuple[str, str, str, str, float, tuple[str, ...], tuple[float, ...]], ...] = (
        ("b_g", "gyro_bias", "Gyro bias", "deg/s", DEG, xyz, ()),
        ("b_a", "accel_bias", "Accelerometer bias", "m/s²", 1.0, xyz, ()),
        ("l_b", "lever_arm", "Lever arm of GNSS", "m", 1.0, xyz, arm),
        ("tau", "delay", "Delay of GNSS", "ms", 1e3, ("delay",), ()),
        ("b_baro", "baro_bias", "Level of the barometer", "m", 1.0, ("level",), ()),
        ("b_m", "hard_iron", "Hard iron", "share of the field", 1.0, xyz, ()),
        ("g_n", "gravity", "Turn of gravity", "mdeg", 1e3 * DEG, ("n", "e"), ()),
    )
    for name, key, title, unit, scale, parts, setting in groups:
        if not result.has(name):
            continue
        values, sigmas = result.state(name)
        panels = []
        for i, part in enumerate(parts):
            value, sigma = scale * values[:, i], 3.0 * scale * sigmas[:, i]
            series = [
                band(_BAND, t, value - sigma, value + sigma),
                line("estimate", t, value, AXIS_COLORS[0]),
            ]
            if setting:
                series.append(level("setting", t, scale * setting[i]))
            panels.append(Panel(f"{part}, {unit}", tuple(series)))
        yield Figure(key, title, tuple(panels), height=170 if len(panels) > 1 else 240)
