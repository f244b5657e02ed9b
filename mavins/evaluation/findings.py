"""What a result says in plain language: what is fine, what is wrong, and what to change.

Each rule is a function of a result that yields findings, or none where it has nothing to go by. The criteria and
where they come from: docs/theory/findings.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mavins.estimates import Result
from mavins.evaluation.errors import Errors
from mavins.types import FloatArray

Level = Literal["wrong", "note", "fine"]
LEVELS: Final[tuple[Level, ...]] = ("wrong", "note", "fine")


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence about a result, what to do about it, and the figure that shows it."""

    level: Level
    text: str
    advice: str = ""
    figure: str = ""


Rule = Callable[[Result], Iterator[Finding]]

_OUTSIDE: Final = 0.05
"""More of the errors than this beyond 3 sigma is wrong; right would be 0.0027."""
_MODEST: Final = 0.2
"""Errors smaller than this many sigmas in the RMS: the sigmas say little."""
_UNOBSERVABLE: Final = math.radians(10.0)
_LONG_BIAS: Final = 3.0
AXES: Final = ("x", "y", "z")
NED: Final = ("north", "east", "down")


def findings(result: Result) -> list[Finding]:
    """What all rules say, the worst first."""
    from mavins.evaluation.findings_aiding import RULES as OF_AIDING
    from mavins.evaluation.findings_sensors import RULES as OF_SENSORS

    rules: tuple[Rule, ...] = (*RULES, *OF_AIDING, *OF_SENSORS)
    found = [finding for rule in rules for finding in rule(result)]
    return sorted(found, key=lambda finding: LEVELS.index(finding.level))


def listed(words: list[str]) -> str:
    """A, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def times(ratio: float) -> str:
    """A ratio in words: 3 x."""
    return f"{ratio:.2g} x" if ratio < 10.0 else f"{ratio:.0f} x"


def an_estimate(result: Result) -> Iterator[Finding]:
    """Is there an estimate, and was there one at the end?"""
    summary = result.summary
    health, reason = summary.get("health", "running"), summary.get("reason", "")
    if not len(result):
        yield Finding("wrong", f"There is no estimate: {health}, {reason}.")
    elif health not in ("running", "aligning"):
        level: Level = "wrong" if health == "diverged" else "note"
        yield Finding(level, f"At the end the estimate was not running: {health}, {reason}.")


def begun_anew(result: Result) -> Iterator[Finding]:
    """Did the estimate jump, or begin anew?"""
    summary = result.summary
    resets, anew = summary.get("resets") or 0, summary.get("realignments") or 0
    if resets:
        yield Finding(
            "wrong",
            f"The estimate was reset to GNSS {resets} times, after measurements had been rejected for "
            f"{result.config.gnss.reset_after:g} s.",
            "Look at the rejected measurements just before: is GNSS wrong there, or the heading?",
            "gnss_position",
        )
    if anew:
        yield Finding(
            "wrong",
            f"The estimate began anew {anew} times.",
            "Look for gaps of the IMU, and for a heading that was wrong.",
            "rates",
        )
    if summary.get("reboots"):
        yield Finding("note", f"The vehicle rebooted {summary['reboots']} times within the log.")
    if len(result) and not (resets or anew or summary.get("reboots")):
        yield Finding("fine", "One estimate from the start to the end, without a reset.")


def against_truth(result: Result) -> Iterator[Finding]:
    """Are the errors as large as their sigmas? Judged against a truth only: a reference has errors of its own."""
    judge, errors = result.judge, result.errors
    if judge is None or errors is None:
        yield Finding(
            "note",
            "The log has no truth: accuracy shows here only as far as innovations show it.",
        )
        return
    told = []
    for kind, names, error, sigma, scale, unit in _compared(result, errors):
        size = "/".join(f"{scale * v:.3g}" for v in np.sqrt(np.mean(error**2, axis=0)))
        if result.is_true:
            yield _judged(kind, names, abs(error) / sigma, f"{size} {unit}")
        else:
            told.append(f"{kind} {size} {unit}")
    if told:
        yield Finding(
            "note",
            f"The log has no truth. The estimate differs from {judge.source} by {listed(told)} RMS; "
            "that has errors of its own.",
            figure="error_position",
        )


def _compared(
    result: Result, errors: Errors
) -> Iterator[tuple[str, tuple[str, ...], FloatArray, FloatArray, float, str]]:
    """Kind, names, errors (K, 3), sigmas (K, 3), and what makes the unit of them."""
    judged = np.isin(result.t_us, errors.t_us)
    for kind, names, error, sigma, scale, unit in (
        ("position", NED, errors.pos, result.sd_p_n, 1.0, "m"),
        ("velocity", NED, errors.vel, result.sd_v, 1.0, "m/s"),
        ("attitude", ("roll", "pitch", "yaw"), errors.att, result.sd_euler, 180.0 / math.pi, "deg"),
    ):
        known = np.isfinite(error).all(axis=1)
        if known.any():
            yield kind, names, error[known], np.maximum(sigma[judged][known], 1e-12), scale, unit


def _judged(kind: str, names: tuple[str, ...], ratio: FloatArray, size: str) -> Finding:
    """An error in sigmas (K, 3) against what it should be."""
    outside = (ratio > 3.0).mean(axis=0)
    rms = np.sqrt(np.mean(ratio**2, axis=0))
    head = f"{kind.capitalize()} error against truth {size} RMS ({'/'.join(names)})"
    bad = [f"{n} {100 * o:.0f} %" for n, o in zip(names, outside, strict=True) if o > _OUTSIDE]
    if bad:
        return Finding(
            "wrong",
            f"{head}; beyond 3 sigma for {listed(bad)} of the time.",
            "The filter is too sure of itself: raise the noises that are too small, or find the "
            "delay, heading or lever arm that is wrong.",
            f"error_{kind}",
        )
    if (rms < _MODEST).all():
        return Finding(
            "note",
            f"{head}, and its sigmas are {times(1 / rms.max())} that.",
            "The filter could be surer: its noises are larger than this flight needs.",
            f"error_{kind}",
        )
    return Finding("fine", f"{head}, and its sigmas fit.", figure=f"error_{kind}")


def yaw(result: Result) -> Iterator[Finding]:
    """Has the yaw been found?"""
    if not len(result):
        return
    sigma = float(np.median(result.sd_euler[len(result) // 2 :, 2]))
    if sigma > _UNOBSERVABLE:
        yield Finding(
            "wrong",
            f"The yaw is not known: its sigma is {math.degrees(sigma):.0f} deg in the second half.",
            "Give a heading or a magnetometer, or fly with horizontal accelerations.",
            "attitude",
        )
    elif not {"heading", "magnetometer"} & set(result.innovations):
        yield Finding(
            "fine",
            f"Without a heading, the yaw came from motion, to {math.degrees(sigma):.1f} deg.",
            figure="attitude",
        )


def biases(result: Result) -> Iterator[Finding]:
    """Are the biases as large as they were expected to be?"""
    if not len(result):
        return
    imu = result.config.imu
    fine = True
    sensors = (
        ("gyro", result.b_g[-1], imu.gyro_bias_sigma, "rad/s"),
        ("accel", result.b_a[-1], imu.accel_bias_sigma, "m/s^2"),
    )
    for name, values, expected, unit in sensors:
        i = int(np.argmax(abs(values)))
        ratio = abs(values[i]) / expected
        if ratio > _LONG_BIAS:
            fine = False
            yield Finding(
                "note",
                f"The {name} bias {AXES[i]} is {values[i]:.3g} {unit} at the end, {times(ratio)} "
                f"what imu.{name}_bias_sigma expects.",
                f"Calibrate the sensor, or set imu.{name}_bias_sigma: {abs(values[i]):.2g}",
                f"{name}_bias",
            )
    if fine:
        yield Finding("fine", "The biases of the IMU are as small as expected.", figure="gyro_bias")


def lever_arm(result: Result) -> Iterator[Finding]:
    """Where the lever arm is estimated: does the setting agree?"""
    if not result.has("l_b") or not len(result):
        return
    found, sigma = (part[-1] for part in result.state("l_b"))
    apart = abs(found - np.array(result.config.gnss.lever_arm))
    if (apart > np.maximum(3.0 * sigma, 0.1)).any():
        place = ", ".join(f"{v:.2f}" for v in found)
        yield Finding(
            "note",
            f"The antenna lies at [{place}] m from the IMU, by the flight itself.",
            f"Measure it, or set gnss.lever_arm: [{place}]",
            "lever_arm",
        )
    else:
        yield Finding("fine", "The lever arm is as it was set.", figure="lever_arm")


RULES: Final[tuple[Rule, ...]] = (
    an_estimate,
    begun_anew,
    against_truth,
    yaw,
    biases,
    lever_arm,
)
