"""Rules about the measurements: delay, rejections, NIS, whiteness, biases, and the accuracies that GNSS claims."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final

import numpy as np

from mavins.estimates import Innovations, Result
from mavins.evaluation.findings import NED, Finding, Rule, listed, times
from mavins.evaluation.innovation_tests import (
    autocorrelation,
    bias,
    further_delay,
    noise_shown,
)

FEWEST: Final = 50
"""Measurements of an aiding below which nothing is said of its statistics."""
_DELAY_S: Final = 0.03
_REJECTED: Final = (0.01, 0.05)
"""Shares beyond the gate that are noted, and that are wrong; a gate of 5 sigmas lets a millionth through."""
_NIS: Final = (0.5, 1.5, 3.0)
"""Per row: below the first too modest, above the second too sure, above the third wrong."""
_WHITE: Final = 0.3
_HEADING_BIAS: Final = math.radians(2.0)
_CLAIMS: Final = (0.5, 3.0)
"""Shown over claimed: outside this the claim is said to be wrong."""
_LIMITS: Final = {
    "gnss_position": "gnss.position_floor",
    "gnss_velocity": "gnss.velocity_floor",
    "heading": "heading.sigma_deg",
    "magnetometer": "magnetometer.sigma",
    "baro": "baro.sigma",
    "zero_velocity": "zero_velocity.sigma",
    "zero_rate": "zero_velocity.rate_sigma",
}
"""The setting of each aiding's noise."""


def words(aiding: str) -> str:
    """An aiding's name as a sentence has it."""
    return aiding.replace("gnss", "GNSS").replace("_", " ")


def _of(result: Result) -> Iterator[tuple[str, Innovations]]:
    """The aidings with enough measurements, standing pseudo-measurements aside: their errors are not noise."""
    for name, innovations in result.innovations.items():
        if int(innovations.accepted.sum()) >= FEWEST and not name.startswith("zero"):
            yield name, innovations


def _assumed(result: Result, aiding: str) -> list[float]:
    told = result.summary.get("aiding", {}).get(aiding, {})
    return [float(v) for v in told.get("assumed_noise", [])]


def delay(result: Result) -> Iterator[Finding]:
    """Is GNSS as old as it was taken for?"""
    velocity = result.innovations.get("gnss_velocity")
    if not len(result):
        return
    if result.has("tau"):
        yield from _estimated_delay(result)
    elif velocity is not None and _assumed(result, "gnss_velocity"):
        assumed = np.array(_assumed(result, "gnss_velocity"))
        more, sigma = further_delay(velocity, result, assumed)
        taken = float(np.median(velocity.stamp_us - velocity.t_us)) * 1e-6
        if not math.isfinite(more) or sigma > _DELAY_S:
            yield Finding("note", "The delay of GNSS does not show: too little acceleration.")
        elif abs(more) > max(_DELAY_S, 4.0 * sigma):
            yield _late(taken + more, taken, sigma)
        else:
            yield Finding(
                "fine",
                f"GNSS and IMU fit in time: {1e3 * more:.0f} ms +- {1e3 * sigma:.0f} are left beside the "
                f"{1e3 * taken:.0f} ms assumed.",
                figure="gnss_velocity",
            )


def _estimated_delay(result: Result) -> Iterator[Finding]:
    tau, sigma = (float(part[-1, 0]) for part in result.state("tau"))
    first = float(result.state("tau")[0][0, 0])
    if sigma > max(_DELAY_S, 0.5 * result.config.states.gnss_delay_sigma):
        yield Finding(
            "note",
            f"The delay of GNSS does not show ({1e3 * tau:.0f} ms +- {1e3 * sigma:.0f}): too little "
            "acceleration.",
            figure="delay",
        )
    elif abs(tau - first) > max(_DELAY_S, 3.0 * sigma):
        yield _late(tau, first, sigma, estimated=True)
    else:
        yield Finding(
            "fine",
            f"GNSS and IMU fit in time: a delay of {1e3 * tau:.0f} ms +- {1e3 * sigma:.0f} was "
            f"estimated, {1e3 * first:.0f} ms assumed at first.",
            figure="delay",
        )


def _late(delay: float, taken: float, sigma: float, estimated: bool = False) -> Finding:
    lags = "lags the IMU by" if delay >= 0.0 else "is ahead of the IMU by"
    text = (
        f"GNSS {lags} {1e3 * abs(delay):.0f} ms +- {1e3 * sigma:.0f}; {1e3 * taken:.0f} ms were "
        f"assumed{' at first' if estimated else ''}."
    )
    if estimated:
        advice = f"The filter has found it; from the start on with gnss.delay: {delay:.2f}"
        return Finding("note", text, advice, "delay")
    advice = f"Set gnss.delay: {delay:.2f}, or states.gnss_delay: estimate"
    return Finding("wrong", text, advice, "gnss_velocity")


def rejected(result: Result) -> Iterator[Finding]:
    """How many measurements were refused, and why?"""
    quiet = True
    for name, innovations in result.innovations.items():
        reasons = Counter(innovations.reason[~innovations.accepted].tolist())
        n = len(innovations)
        for reason, count in reasons.items():
            share = count / n
            if n < FEWEST or count < 2 or share <= _REJECTED[0] or reason == "reset":
                continue
            quiet = False
            bad = share > _REJECTED[1]
            text = f"{100 * share:.1f} % of the {words(name)} measurements were refused ({count} of {n}): "
            if reason == "gate":
                yield Finding(
                    "wrong" if bad else "note",
                    f"{text}beyond the gate.",
                    f"See whether the sensor or the estimate is wrong there; {_LIMITS.get(name, 'its noise')} "
                    "if its noise was taken too small.",
                    name,
                )
            else:
                yield Finding("note", f"{text}{reason}.", figure=name)
    if quiet and result.innovations:
        yield Finding("fine", "Hardly a measurement was refused.")


def nis(result: Result) -> Iterator[Finding]:
    """Are the innovations as large as expected?"""
    fine, small = [], []
    for name, innovations in _of(result):
        used = innovations.accepted
        rows = np.isfinite(innovations.innovation[used]).sum()
        value = float(np.nansum(innovations.nis[used]) / max(rows, 1))
        ratio = math.sqrt(max(value, 1e-12))
        if value < _NIS[0]:
            small.append(f"{words(name)} {times(1.0 / ratio)} (NIS {value:.2g} per row)")
        elif value > _NIS[1]:
            yield Finding(
                "wrong" if value > _NIS[2] else "note",
                f"Innovations of {words(name)} are {times(ratio)} larger than expected (NIS {value:.2g} "
                "per row, where 1 is right).",
                f"Raise {_LIMITS.get(name, 'its noise')}, or the IMU's noises.",
                name,
            )
        else:
            fine.append(words(name))
    if small:
        yield Finding(
            "note",
            f"Innovations are smaller than expected: {listed(small)}; 1 per row is right.",
            "The noises are set larger than this flight needs: safe, but slow to learn. "
            "`mavins tune LOG` finds smaller ones.",
            "nis",
        )
    if fine:
        yield Finding("fine", f"The innovations of {listed(fine)} are as large as expected.")


def whiteness(result: Result) -> Iterator[Finding]:
    """Do innovations know of those before them?"""
    fine, coloured = [], []
    for name, innovations in _of(result):
        r = (innovations.innovation / innovations.sigma)[innovations.accepted]
        first = [autocorrelation(c[np.isfinite(c)], 1)[0] for c in r.T]
        known = [value for value in first if math.isfinite(value)]
        largest = max(known, key=abs, default=0.0)
        if abs(largest) > _WHITE:
            coloured.append(f"{words(name)} {largest:.2f}")
        else:
            fine.append(words(name))
    if coloured:
        yield Finding(
            "note",
            f"Innovations are not white; the correlation of each with the one before: {listed(coloured)}.",
            "An error that lasts: of the sensor, as of an autopilot's own estimate, or of settings that make "
            "the filter too slow or too quick.",
            "whiteness",
        )
    if fine:
        yield Finding("fine", f"The innovations of {listed(fine)} are white.", figure="whiteness")


def biased(result: Result) -> Iterator[Finding]:
    """Do innovations have a mean?"""
    for name, innovations in _of(result):
        seen = innovations.select(np.isfinite(innovations.innovation[:, 0]))
        for i in range(seen.innovation.shape[1]):
            mean, sigma = bias(seen, i)
            expected = float(np.nanmedian(seen.sigma[:, i]))
            least = _HEADING_BIAS if name == "heading" else 0.5 * expected
            if not abs(mean) > max(4.0 * sigma, least):
                continue
            if name == "heading":
                text = f"Heading innovations are biased by {math.degrees(mean):.1f} deg."
                advice = "Check the compass: calibration, declination, mounting; or heading.delay in turns."
            else:
                part = f" {NED[i]}" if name.startswith("gnss") else f", component {i}"
                size = f"{mean:.2g}, {abs(mean) / expected:.1f} sigmas"
                text = f"Innovations of {words(name)}{part} are biased by {size}."
                advice = "A steady error of this sensor, or of another that it disagrees with."
            yield Finding("wrong" if name == "heading" else "note", text, advice, name)


def claims(result: Result) -> Iterator[Finding]:
    """Are the accuracies that GNSS reports the ones that its innovations show?"""
    if result.evidence is None:
        return
    gnss, settings = result.evidence.gnss, result.config.gnss
    kinds = (
        ("horizontal position", "gnss_position", slice(0, 2), 0, settings.position_floor, "m"),
        ("vertical position", "gnss_position", slice(2, 3), 1, settings.position_floor, "m"),
        ("velocity", "gnss_velocity", slice(0, 3), 2, settings.velocity_floor, "m/s"),
    )
    right = []
    for kind, aiding, components, column, floor, unit in kinds:
        told = gnss.sigmas[:, column]
        told = told[np.isfinite(told)]
        innovations, assumed = result.innovations.get(aiding), _assumed(result, aiding)
        if innovations is None or len(told) < FEWEST or len(innovations) < FEWEST or not assumed:
            continue
        each = [noise_shown(innovations, i, assumed[i]) for i in range(len(assumed))[components]]
        if not each:
            continue
        claim, shown = float(np.median(told)), float(np.sqrt(np.mean(np.square(each))))
        ratio = shown / max(claim, 1e-9)
        head = f"GNSS claims a {kind} accuracy of {claim:.2g} {unit}, its innovations show {shown:.2g} {unit}"
        if ratio < 1.0 / _CLAIMS[1]:
            yield Finding(
                "note",
                f"{head}: {times(1 / ratio)} too large.",
                "A slow error would not show in innovations; if there is none, the receiver is too modest.",
                "gnss_quality",
            )
        elif ratio > 1.0 / _CLAIMS[0]:
            covered = floor >= _CLAIMS[0] * shown
            yield Finding(
                "note" if covered else "wrong",
                f"{head}: {times(ratio)} too small"
                + (f", which the floor of {floor:g} {unit} covers." if covered else "."),
                "" if covered else f"Set {_LIMITS[aiding]}: {shown:.2g}",
                "gnss_quality",
            )
        else:
            right.append(kind)
    if right:
        yield Finding(
            "fine",
            f"GNSS accuracies are reported as its innovations show them: {listed(right)}.",
            figure="gnss_quality",
        )


RULES: Final[tuple[Rule, ...]] = (delay, rejected, nis, whiteness, biased, claims)
