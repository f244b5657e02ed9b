"""Rules about the sensors themselves: noise, rate, gaps, the accelerometer's limit, fixes, damage of the log."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from mavins.estimates import Result
from mavins.evaluation.findings import AXES, Finding, Rule, times
from mavins.types import IntArray

_NOISE: Final = (0.1, 2.0)
"""Measured over set: below the first the setting leaves much room, above the second it is too small."""
_LOW_BAND_HZ: Final = 20.0
"""Up to here no low-pass filter of an autopilot has taken the noise away."""
_SLOWEST_HZ: Final = 80.0
_MISSING: Final = 0.01
_GAP_S: Final = 0.2
_NO_FIX: Final = 0.02
_HARMLESS: Final = ("unknown",)


def imu_noise(result: Result) -> Iterator[Finding]:
    """Is the IMU as noisy as it is set?"""
    spectrum = result.evidence.spectrum if result.evidence is not None else None
    if spectrum is None:
        return
    imu = result.config.imu
    white, low = spectrum.noise_density(), spectrum.noise_density(_LOW_BAND_HZ)
    for name, at, setting, unit in (
        ("gyro", slice(0, 3), imu.gyro_noise, "rad/s/sqrt(Hz)"),
        ("accel", slice(3, 6), imu.accel_noise, "m/s^2/sqrt(Hz)"),
    ):
        if not (np.isfinite(white[at]).all() and np.isfinite(low[at]).all()):
            continue
        i, largest = int(np.argmax(white[at])), float(low[at].max())
        shown = float(white[at][i])
        if shown > _NOISE[1] * setting:
            yield Finding(
                "wrong",
                f"The {name} noise is {times(shown / setting)} its setting: {shown:.2g} {unit} above 10 Hz "
                f"({AXES[i]}), where {setting:.2g} is set.",
                f"Set imu.{name}_noise: {shown:.2g}, or damp the vibration.",
                "spectrum",
            )
        elif largest < _NOISE[0] * setting:
            yield Finding(
                "note",
                f"The {name} noise is set to {times(setting / largest)} what shows: {setting:.2g} {unit}, where "
                f"10 to 20 Hz have {largest:.2g}.",
                f"The default leaves room for vibration; a calm vehicle may take a smaller imu.{name}_noise.",
                "spectrum",
            )
        else:
            yield Finding(
                "fine",
                f"The {name} noise is {shown:.2g} {unit} above 10 Hz; its setting of {setting:.2g} fits.",
                figure="spectrum",
            )


def imu_rate(result: Result) -> Iterator[Finding]:
    """Does the IMU come often enough, and without gaps?"""
    if result.evidence is None or not len(result.evidence.imu.t_us):
        return
    imu = result.evidence.imu
    total = int(imu.intervals.sum())
    if not total:
        return
    rate = float(np.median(imu.count))
    usual = 1.0 / rate
    longer = float(imu.intervals[round(1.5 * usual * 1e4) :].sum()) / total
    longest = float(imu.longest_us.max()) * 1e-6
    good = True
    if rate < _SLOWEST_HZ:
        good = False
        yield Finding(
            "note",
            f"The IMU comes at {rate:.0f} Hz only.",
            "Ask the autopilot for 100 to 200 Hz: between samples, turns and vibration are lost.",
            "rates",
        )
    if longest > _GAP_S:
        good = False
        at = float(imu.t_us[int(np.argmax(imu.longest_us))]) * 1e-6
        n = int((imu.longest_us * 1e-6 > _GAP_S).sum())
        yield Finding(
            "wrong",
            f"The IMU has gaps of more than {_GAP_S:g} s in {n} seconds of the log, the longest of "
            f"{longest:.2f} s at {at:.0f} s.",
            "Look for a link or a logger that cannot keep up.",
            "rates",
        )
    elif longer > _MISSING:
        good = False
        yield Finding(
            "note",
            f"{100 * longer:.1f} % of the intervals between IMU samples are longer than 1.5 times the usual "
            f"{1e3 * usual:.1f} ms: samples are missing.",
            "Look for a link or a logger that cannot keep up.",
            "intervals",
        )
    if good:
        yield Finding("fine", f"The IMU comes at {rate:.0f} Hz, without gaps.", figure="rates")


def clipping(result: Result) -> Iterator[Finding]:
    """Was the accelerometer at its limit?"""
    if result.evidence is None or not len(result.evidence.imu.t_us):
        return
    clipped = result.evidence.imu.clipped
    if clipped.any():
        yield Finding(
            "wrong",
            f"The accelerometer was at its limit in {int(clipped.sum())} samples, in "
            f"{int((clipped > 0).sum())} seconds of the log.",
            "Damp its mounting, or take a sensor of a larger range.",
            "vibration",
        )


def fixes(result: Result) -> Iterator[Finding]:
    """Did GNSS come steadily, and with a fix?"""
    if result.evidence is None:
        return
    gnss = result.evidence.gnss
    if len(gnss.t_us) < 2:
        yield Finding("wrong", "There is no GNSS in this log.", "Check the receiver, and --gnss.")
        return
    usual, longest, at = _steps(gnss.t_us)
    lost = float((gnss.fix_type < 3).mean())
    good = True
    after = result.config.estimator.dead_reckoning_after
    if longest > max(1.0, 3.0 * usual):
        good = False
        yield Finding(
            "wrong" if longest > after else "note",
            f"GNSS was silent for {longest:.1f} s at {at:.0f} s; usually a fix comes every {usual:.2g} s.",
            f"After {after:g} s without, the estimate is dead reckoning."
            if longest > after
            else "",
            "rates",
        )
    if lost > _NO_FIX:
        good = False
        yield Finding(
            "note",
            f"{100 * lost:.0f} % of the GNSS messages had no 3-D fix.",
            figure="gnss_quality",
        )
    if good:
        yield Finding("fine", f"GNSS came steadily, every {usual:.2g} s.", figure="gnss_quality")


def _steps(t_us: IntArray) -> tuple[float, float, float]:
    """The usual and the longest interval, and where it began, all in s."""
    steps = np.diff(t_us) * 1e-6
    k = int(np.argmax(steps))
    return max(float(np.median(steps)), 1e-6), float(steps[k]), float(t_us[k]) * 1e-6


def damage(result: Result) -> Iterator[Finding]:
    """Could all of the log be read and used?"""
    hurt = {k: v for k, v in (result.summary.get("damage") or {}).items() if k not in _HARMLESS}
    if any(hurt.values()):
        told = ", ".join(f"{k.replace('_', ' ')} {v}" for k, v in hurt.items() if v)
        yield Finding("note", f"The log is damaged: {told}.", "What is intact was used.")


RULES: Final[tuple[Rule, ...]] = (imu_noise, imu_rate, clipping, fixes, damage)
