"""No magnetometer: a heading that is wrong by 45 deg at the start, found from GNSS position and velocity in motion.

A simulated vehicle takes off, gathers speed and flies circles at 3 m/s^2; on the way the receiver gets five times as
bad for half a minute, and says so. The estimator is told one heading, at the alignment, and no other.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins.config import Config
from mavins.estimator.solution import SD_EULER, SD_P, SD_V
from mavins.evaluation.compare import Run
from mavins.evaluation.compare import run as play
from mavins.evaluation.tape import Tape
from mavins.examples import drawing
from mavins.examples.base import Figure
from mavins.examples.scenarios import flight, matched
from mavins.logs.truth import Truth
from mavins.nav.so3 import wrap_pi
from mavins.types import FloatArray
from sitl.scenario import Scenario, parse
from sitl.simulation import START_US

FILTERS: Final = ("srcdkf", "iekf")
SEEDS: Final = range(5)
DURATION: Final = 125.0
WRONG: Final = math.radians(45.0)
"""The error of the only heading, and the sigma that it comes with."""
ROUGH: Final = (75.0, 105.0)
"""From when to when (s) the receiver is worse; the heading's sigma has settled by then."""
WORSE: Final = 5.0
"""How much larger its noise is then."""
RECOVERY: Final = 15.0
"""How long (s) after it the sigmas are looked at again."""
GATE: Final = 100.0
"""In sigmas: as good as none. While the heading is as wrong as this, a velocity is far off for good reason."""
FOUND_WITHIN: Final = 20.0
PUSH: Final = 1.0
SPEED: Final = 15.0
HEADING_LIMIT: Final = 3.0
TILT_LIMIT: Final = 0.5

# the climb is gentle: the first acceleration above 1 m/s^2 is that along the circle
SCENARIO: Final = {
    "description": "Circles of 75 m at 15 m/s, which is 3 m/s^2.",
    "origin": {"lat_deg": 47.3977, "lon_deg": 8.5456, "alt": 488.0},
    "motion": {
        "kind": "plan",
        "yaw_deg": 30,
        "segments": [
            {"do": "take_off", "height": 20, "speed": 2.5, "acceleration": 0.5},
            {"do": "hover", "seconds": 2},
            {"do": "circle", "north": 0, "east": 75, "turns": 4, "speed": SPEED, "acceleration": 3},
            {"do": "land", "speed": 2, "acceleration": 0.5},
        ],
    },
    "imu": {
        "rate": 250,
        "gyro": {"noise": 3e-4, "bias": 0.005, "bias_walk": 1e-5},
        "accel": {"noise": 3e-3, "bias": 0.05, "bias_walk": 1e-4},
    },
    "gnss": {"rate": 5, "sigma_h": 0.5, "sigma_v": 0.8, "sigma_speed": 0.1},
    "heading": {"rate": 1, "sigma_deg": 0.0},
}


def worse(scenario: Scenario) -> Scenario:
    """The same flight with the worse receiver."""
    g = scenario.gnss
    return dataclasses.replace(
        scenario,
        gnss=dataclasses.replace(
            g,
            sigma_h=WORSE * g.sigma_h,
            sigma_v=WORSE * g.sigma_v,
            sigma_speed=WORSE * g.sigma_speed,
        ),
    )


def recorded(config: Config, scenario: Scenario, seed: int) -> tuple[Tape, Truth]:
    """What the estimator is fed: the first heading, turned by 45 deg, and fixes that are worse for a while."""
    calm, truth = flight(config, scenario, seed, DURATION)
    # a seed gives the same draws, so the two flights differ in their fixes alone
    rough, _ = flight(config, worse(scenario), seed, DURATION)
    begin_us, end_us = (START_US + round(t * 1e6) for t in ROUGH)
    tape = Tape(config)
    told = False
    for (name, what), (_, as_rough) in zip(calm.feeds, rough.feeds, strict=True):
        if name == "feed_gnss":
            tape.feed_gnss(as_rough if begin_us <= what.t_us < end_us else what)
        elif name != "feed_heading":
            tape.feeds.append((name, what))
        elif not told:
            tape.feed_heading(dataclasses.replace(what, yaw=wrap_pi(what.yaw + WRONG), sigma=WRONG))
            told = True
    return tape, truth


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """When the vehicle first accelerates by more than 1 m/s^2, and when it is at speed in the circles (s from boot)."""

    push: float
    circling: tuple[float, float]


def manoeuvre_of(truth: Truth) -> Manoeuvre:
    """The times of the manoeuvre, as the true velocities show them."""
    t = truth.t_us * 1e-6
    acceleration = np.linalg.norm(np.gradient(truth.v_l, t, axis=0), axis=1)
    speed = np.linalg.norm(truth.v_l[:, :2], axis=1)
    circling = t[speed > SPEED - 0.1]
    return Manoeuvre(float(t[np.argmax(acceleration > PUSH)]), (circling[0], circling[-1]))


@dataclass(frozen=True, slots=True)
class Verdict:
    """One run: deg, s after the first push, and sigmas before, at the end of and after the worse receiver.

    `before` is the heading error just before the push, `late` the largest from 20 s after it on, `found` when it was
    below 3 deg for good, `tilt` the RMS of roll and pitch in the circles. `sigmas` has a row for each of the three
    times: position and velocity (horizontal, m and m/s) and heading (deg).
    """

    before: float
    late: float
    found: float
    tilt: FloatArray
    sigmas: FloatArray


def sigmas_at(run: Run, seconds: float) -> FloatArray:
    """(position, velocity, heading) 1-sigma at a time from the start: m and m/s horizontally, deg."""
    k = int(np.searchsorted(run.t_us, START_US + round(seconds * 1e6)))
    row = run.rows[k]
    return np.array(
        [
            math.hypot(*row[SD_P][:2]),
            math.hypot(*row[SD_V][:2]),
            math.degrees(row[SD_EULER][2]),
        ]
    )


def verdict_of(run: Run, manoeuvre: Manoeuvre) -> Verdict:
    """Hold a run against the truth from the first push to the end of the circles."""
    assert run.errors is not None
    t = run.errors.t_us * 1e-6
    att = np.abs(np.degrees(run.errors.att))
    flying = t <= manoeuvre.circling[1]
    t, att = t[flying], att[flying]
    since, heading = t - manoeuvre.push, att[:, 2]
    wrong = np.flatnonzero(heading >= HEADING_LIMIT)
    sustained = t >= manoeuvre.circling[0]
    return Verdict(
        before=float(heading[since <= 0.0][-1]),
        late=float(heading[since > FOUND_WITHIN].max()),
        found=float(since[min(wrong[-1] + 1, len(since) - 1)]) if len(wrong) else 0.0,
        tilt=np.sqrt(np.mean(att[sustained, :2] ** 2, axis=0)),
        sigmas=np.array([sigmas_at(run, s) for s in (ROUGH[0], ROUGH[1], ROUGH[1] + RECOVERY)]),
    )


def figures_of(name: str, verdicts: Sequence[Verdict]) -> Sequence[Figure]:
    """The worst of all seeds."""
    late = max(v.late for v in verdicts)
    tilt = np.max([v.tilt for v in verdicts], axis=0)
    sigmas = np.array([v.sigmas for v in verdicts])
    shares = np.max(sigmas[:, [0, 2]] / sigmas[:, [1]], axis=0)
    figures = [
        Figure(f"{name}: heading error from 20 s after the push on", late, HEADING_LIMIT, "deg"),
        Figure(f"{name}: roll, RMS in the circles", float(tilt[0]), TILT_LIMIT, "deg"),
        Figure(f"{name}: pitch, RMS in the circles", float(tilt[1]), TILT_LIMIT, "deg"),
    ]
    for when, row in zip(("before", "after"), shares, strict=True):
        for what, share in zip(("position", "velocity", "heading"), row, strict=True):
            label = f"{name}: {what} sigma {when} the worse receiver, over that with it"
            figures.append(Figure(label, float(share), 1.0))
    return figures


def run(data: Path | None, out: Path | None, say: Callable[[str], None]) -> Sequence[Figure]:
    """Five seeds through both filters; each figure is the worst of them."""
    scenario = parse(SCENARIO)
    settings = matched(Config(), scenario)
    settings = dataclasses.replace(settings, gnss=dataclasses.replace(settings.gnss, gate=GATE))
    say("one heading, wrong by 45 deg; GNSS position and velocity at 5 Hz; circles at 3 m/s^2")
    flights = [recorded(settings, scenario, seed) for seed in SEEDS]
    manoeuvre = manoeuvre_of(flights[0][1])
    figures: list[Figure] = []
    runs: dict[str, list[Run]] = {}
    for name in FILTERS:
        runs[name] = [play(name, settings, tape, truth) for tape, truth in flights]
        verdicts = [verdict_of(run, manoeuvre) for run in runs[name]]
        for line in lines_of(name, verdicts):
            say(line)
        figures += figures_of(name, verdicts)
    if out is not None and (plot := drawing.pyplot(say)) is not None:
        draw(plot, out / "no-magnetometer.png", runs, manoeuvre)
    return figures


def lines_of(name: str, verdicts: Sequence[Verdict]) -> Sequence[str]:
    """A table of text: a row for each seed."""
    columns = ("before deg", "found s", "late deg", "roll deg", "pitch deg")
    lines = [f"{name:<8}" + "".join(f"{c:>11}" for c in columns)]
    for seed, v in zip(SEEDS, verdicts, strict=True):
        values = f"{v.before:11.1f}{v.found:11.1f}{v.late:11.2f}{v.tilt[0]:11.3f}{v.tilt[1]:11.3f}"
        lines.append(f"seed {seed:<3}{values}")
    sigmas = np.max([v.sigmas for v in verdicts], axis=0)
    for when, row in zip(("before", "with", "after"), sigmas, strict=True):
        said = f"position {row[0]:.3f} m, velocity {row[1]:.3f} m/s, heading {row[2]:.3f} deg"
        lines.append(f"  sigmas {when} the worse receiver: {said}")
    return lines


def draw(plot: Any, path: Path, runs: dict[str, list[Run]], manoeuvre: Manoeuvre) -> None:
    """A picture of the heading errors of all seeds, and of the sigmas of the first."""
    figure, axes = plot.subplots(
        2, len(runs), squeeze=False, sharex=True, sharey="row", figsize=(10.0, 6.0), layout="tight"
    )
    for (error, sigma), (name, several) in zip(axes.T, runs.items(), strict=True):
        for result in several:
            assert result.errors is not None
            t = result.errors.t_us * 1e-6 - manoeuvre.push
            error.plot(t, np.abs(np.degrees(result.errors.att[:, 2])), linewidth=0.8)
        error.axhline(HEADING_LIMIT, color="k", linewidth=0.8, linestyle="--")
        error.set(title=name, yscale="log", ylim=(0.01, 180.0))
        t, rows = several[0].t_us * 1e-6 - manoeuvre.push, several[0].rows
        sigma.plot(t, np.degrees(rows[:, SD_EULER][:, 2]), label="heading deg")
        sigma.plot(t, np.hypot(*rows[:, SD_P][:, :2].T), label="position m")
        sigma.plot(t, np.hypot(*rows[:, SD_V][:, :2].T), label="velocity m/s")
        sigma.set(yscale="log", xlabel="s since the push")
        sigma.legend()
    axes[0, 0].set_ylabel("heading error deg")
    axes[1, 0].set_ylabel("sigma")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plot.close(figure)
