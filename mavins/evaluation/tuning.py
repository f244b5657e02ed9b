"""Noises and the delay of GNSS from flights alone: those under which the innovations are likeliest.

Whole logs are run again with other settings, the steps are those of Fisher's scoring within a trust region, and what
is found must also make the last part of each log likelier, which the fit has not seen. No truth is looked at.

Source: Mehra (1970); Gupta and Mehra (1974) for the scores. Theory: docs/theory/tuning.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from mavins.aiding import gnss_position, gnss_velocity, heading
from mavins.errors import MavinsError
from mavins.estimator.settings import Settings
from mavins.evaluation.likelihood import (
    Flight,
    between,
    bounds_of,
    is_same,
    log_likelihood,
)
from mavins.evaluation.replays import Replays
from mavins.evaluation.scoring import Scores, scores_of
from mavins.evaluation.tape import Tape
from mavins.types import FloatArray, GnssFix, HeadingFix

SettingsT = TypeVar("SettingsT", bound=Settings)

SETTLE_US: Final = 10_000_000
"""The alignment's errors are not the sensors': measurements count from this long after the first."""
EDGE_US: Final = 2_000_000
"""At the end, whether a late fix still finds its IMU samples hangs on its delay: the last ones do not count."""
HELD_OUT: Final = 0.3
"""The last part of each log, which the fit does not see."""
OPEN: Final = 5.0
"""While tuning, gates are so many times wider: noises that are set too small must not shut out what would say so."""
STEP: Final = 0.01
MAX_STEPS: Final = 20
ENOUGH: Final = 0.02
"""The search ends where the next step promises less than this of log p."""
BELIEF: Final = 2.3
"""1-sigma of a weak belief in the value that was there, a factor of ten: what a log says nothing of stays near it."""
UNKNOWN: Final = 1.0
"""A parameter whose scaled 1-sigma is larger is left as it was."""
SIGMAS_95: Final = 1.96


@dataclass(frozen=True, slots=True)
class Parameter:
    """A setting that may be tuned, within `low` and `high`; `aiding` must be in the log for it to show.

    On a logarithmic scale the unit of the search is a factor e, on a linear one 0.1.
    """

    path: str
    unit: str
    low: float
    high: float
    aiding: str = ""
    logarithmic: bool = True
    walk: bool = False

    def inner(self, value: float) -> float:
        """The search's own unbounded coordinate: a sine folds it into the bounds."""
        low, half = self._span()
        share = (self._scaled(value) - low - half) / half
        return half * math.asin(min(max(share, -1.0), 1.0))

    def value(self, inner: float) -> float:
        """What a coordinate stands for."""
        low, half = self._span()
        scaled = low + half * (1.0 + math.sin(inner / half))
        value = math.exp(scaled) if self.logarithmic else 0.1 * scaled
        return min(max(value, self.low), self.high)

    def spread(self, value: float, sigma: float) -> tuple[float, float]:
        """The 95 % interval for a 1-sigma of the scaled value."""
        lower, upper = (self._scaled(value) + s * SIGMAS_95 * sigma for s in (-1.0, 1.0))
        if self.logarithmic:
            return math.exp(max(lower, -700.0)), math.exp(min(upper, 700.0))
        return 0.1 * lower, 0.1 * upper

    def slope(self, inner: float) -> float:
        """d scaled / d inner."""
        return math.cos(inner / self._span()[1])

    def is_at_bound(self, value: float) -> bool:
        """True where the search was stopped by a bound."""
        low, half = self._span()
        return min(self._scaled(value) - low, low + 2.0 * half - self._scaled(value)) < 0.02 * half

    def _scaled(self, value: float) -> float:
        return math.log(value) if self.logarithmic else 10.0 * value

    def _span(self) -> tuple[float, float]:
        low, high = self._scaled(self.low), self._scaled(self.high)
        return low, 0.5 * (high - low)


PARAMETERS: Final = (
    Parameter("imu.gyro_noise", "rad/s/sqrt(Hz)", 1e-6, 1.0),
    Parameter("imu.accel_noise", "m/s^2/sqrt(Hz)", 1e-5, 10.0),
    Parameter("imu.gyro_bias_walk", "rad/s^2/sqrt(Hz)", 1e-8, 1e-2, walk=True),
    Parameter("imu.accel_bias_walk", "m/s^3/sqrt(Hz)", 1e-7, 1.0, walk=True),
    Parameter("gnss.position_sigma", "m", 5e-3, 50.0, gnss_position.NAME),
    Parameter("gnss.altitude_sigma", "m", 5e-3, 100.0, gnss_position.NAME),
    Parameter("gnss.velocity_sigma", "m/s", 2e-3, 10.0, gnss_velocity.NAME),
    Parameter("heading.sigma_deg", "deg", 0.05, 60.0, heading.NAME),
    Parameter("gnss.delay", "s", -0.5, 0.8, gnss_position.NAME, logarithmic=False),
)


@dataclass(frozen=True, slots=True)
class Found:
    """A parameter before and after, with its 95 % interval."""

    parameter: Parameter
    before: float
    after: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Tuning:
    """What was found; `fit` and `held_out` are log p before and after, per measurement, with how many there were."""

    found: tuple[Found, ...]
    fit: tuple[float, float, int]
    held_out: tuple[float, float, int]
    steps: int
    replays: int

    @property
    def accepted(self) -> bool:
        """True where the part of the logs that was not fitted has become likelier too."""
        return self.held_out[1] > self.held_out[0]


def get(settings: Settings, path: str) -> Any:
    """The setting at a dotted path."""
    section, name = path.split(".")
    return getattr(getattr(settings, section), name)


def put(settings: SettingsT, values: dict[str, Any]) -> SettingsT:
    """The settings with others at dotted paths."""
    for path, value in values.items():
        section, name = path.split(".")
        changed = dataclasses.replace(getattr(settings, section), **{name: value})
        settings = dataclasses.replace(settings, **{section: changed})
    return settings


def tuned(settings: SettingsT, values: dict[str, float]) -> SettingsT:
    """The settings with tuned values, which hold instead of what sensors report of themselves."""
    changed: dict[str, Any] = dict(values)
    if "gnss.position_sigma" in values:
        changed["gnss.accuracy"] = "configured"
    if "heading.sigma_deg" in values:
        changed["heading.accuracy"] = "configured"
    return put(settings, changed)


def opened(settings: SettingsT) -> SettingsT:
    """The settings with wide gates."""
    gates = ("gnss.gate", "heading.gate", "magnetometer.gate", "baro.gate")
    return put(settings, {gate: min(OPEN * get(settings, gate), 100.0) for gate in gates})


def first_values(tape: Tape, parameters: Sequence[Parameter]) -> dict[str, float]:
    """What is in force now: sensors' own accuracies where those are used."""
    from mavins.estimator.measuring import Measuring
    from mavins.estimator.quality import noise_of

    settings = tape.settings
    fixes = [noise_of(what, settings.gnss) for _, what in tape.feeds if isinstance(what, GnssFix)]
    of_heading = Measuring(settings, ()).heading_sigma
    yaws = [of_heading(what) for _, what in tape.feeds if isinstance(what, HeadingFix)]
    now: dict[str, float] = {"gnss.delay": tape.delay()}
    if fixes:
        now["gnss.position_sigma"] = float(np.median([noise.h for noise in fixes]))
        now["gnss.altitude_sigma"] = float(np.median([noise.v for noise in fixes]))
        now["gnss.velocity_sigma"] = float(np.median([noise.speed for noise in fixes]))
    if yaws:
        now["heading.sigma_deg"] = math.degrees(float(np.median(yaws)))
    return {p.path: float(now.get(p.path, get(settings, p.path))) for p in parameters}


def tune(
    tapes: Sequence[Tape],
    filter_name: str,
    everything: bool,
    jobs: int,
    progress: Callable[[float], None] = lambda _: None,
) -> Tuning:
    """Tune to the sum over logs; bias walks only with `everything`. MavinsError where a log says nothing."""
    tapes = [tape.without_changes() for tape in tapes]
    with Replays(tapes, filter_name, jobs) as replays:
        before = replays.run(
            [(k, opened(tape.settings), None, None) for k, tape in enumerate(tapes)]
        )
        for flight in before:
            if not flight:
                raise MavinsError(
                    "a log yields no estimate to tune: see what is wrong with mavins replay"
                )
        windows = [_window(flight) for flight in before]
        seen = {aiding for flight in before for aiding, _ in flight}
        parameters = [
            p
            for p in PARAMETERS
            if (p.aiding or gnss_position.NAME) in seen and (everything or not p.walk)
        ]
        first = first_values(tapes[0], parameters)
        search = _Search(replays, tapes, windows, parameters, progress)
        inner = np.array([p.inner(first[p.path]) for p in parameters])
        u, sigmas = search.run(inner)
        values = {p.path: p.value(k) for p, k in zip(parameters, u, strict=True)}
        rounded = {path: float(f"{value:.4g}") for path, value in values.items()}
        after = replays.run(
            [
                (k, opened(tuned(tape.settings, rounded)), rounded.get("gnss.delay"), None)
                for k, tape in enumerate(tapes)
            ]
        )
    found = tuple(
        Found(p, first[p.path], rounded[p.path], p.spread(rounded[p.path], sigma))
        for p, sigma in zip(parameters, sigmas.tolist(), strict=True)
    )
    middles = [_middle(window) for window in windows]
    fit = _compared(before, after, [(a, m) for (a, _), m in zip(windows, middles, strict=True)])
    held = _compared(before, after, [(m, b) for (_, b), m in zip(windows, middles, strict=True)])
    return Tuning(found, fit, held, search.steps, replays.count)


def _window(flight: Flight) -> tuple[int, int]:
    start, end = bounds_of(flight)
    return start + SETTLE_US, end - EDGE_US


def _middle(window: tuple[int, int]) -> int:
    """Where the held-out part begins."""
    return round(window[1] - HELD_OUT * (window[1] - window[0]))


def _compared(
    before: Sequence[Flight], after: Sequence[Flight], spans: Sequence[tuple[int, int]]
) -> tuple[float, float, int]:
    """log p per measurement before and after; a run that has lost measurements has none."""
    cut = [
        [between(f, *span) for f, span in zip(flights, spans, strict=True)]
        for flights in (before, after)
    ]
    counts = [
        sum(len(part.stamps) for flight in flights for part in flight.values()) for flights in cut
    ]
    most = max(counts)
    sums = [sum(map(log_likelihood, flights)) for flights in cut]
    one, two = (s / most if n == most else -math.inf for s, n in zip(sums, counts, strict=True))
    return one, two, most


class _Search:
    """The likelihood of the fitted parts as a function of the parameters' inner coordinates."""

    def __init__(
        self,
        replays: Replays,
        tapes: Sequence[Tape],
        windows: Sequence[tuple[int, int]],
        parameters: Sequence[Parameter],
        progress: Callable[[float], None],
    ) -> None:
        self._replays = replays
        self._tapes = tapes
        self._spans = [(start, _middle((start, end))) for start, end in windows]
        self._parameters = parameters
        self._progress = progress
        self._known: dict[bytes, tuple[float, Scores | None]] = {}
        self._reference: list[Flight] | None = None
        self.steps = 0

    def run(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Climb from here; returns where it ended and the scaled parameters' 1-sigma there."""
        self._start = start
        options = {"initial_trust_radius": 1.0, "max_trust_radius": 2.0, "maxiter": MAX_STEPS}
        result = minimize(
            lambda u: -self._at(u)[0],
            start,
            jac=self._gradient,
            hess=self._information,
            method="trust-exact",
            callback=self._look,
            options={**options, "gtol": 0.0},
        )
        scores = self._at(result.x)[1]
        assert scores is not None
        return result.x, scores.sigmas()

    def _look(self, intermediate_result: OptimizeResult) -> None:
        """After each step: is there anything to be gained?"""
        self.steps += 1
        self._progress(min(self.steps / MAX_STEPS, 1.0))
        u = intermediate_result.x
        g = self._gradient(u)
        if 0.5 * g @ np.linalg.solve(self._information(u), g) < ENOUGH:
            raise StopIteration

    def _slopes(self, u: FloatArray) -> FloatArray:
        return np.array([p.slope(k) for p, k in zip(self._parameters, u, strict=True)])

    def _gradient(self, u: FloatArray) -> FloatArray:
        scores = self._at(u)[1]
        assert scores is not None
        return -self._slopes(u) * scores.gradient + (u - self._start) / BELIEF**2

    def _information(self, u: FloatArray) -> FloatArray:
        scores, slopes = self._at(u)[1], self._slopes(u)
        assert scores is not None
        known: FloatArray = slopes[:, None] * scores.information * slopes
        return known + np.eye(len(u)) / BELIEF**2

    def _at(self, u: FloatArray) -> tuple[float, Scores | None]:
        """log p with the belief, and the derivatives of log p alone by the scaled parameters."""
        key = u.tobytes()
        if key not in self._known:
            self._known[key] = self._evaluate(u)
        return self._known[key]

    def _evaluate(self, u: FloatArray) -> tuple[float, Scores | None]:
        points = [u, *(u + STEP * row for row in np.eye(len(u)))]
        jobs = []
        for point in points:
            values = {p.path: p.value(k) for p, k in zip(self._parameters, point, strict=True)}
            for k, tape in enumerate(self._tapes):
                settings = opened(tuned(tape.settings, values))
                settings = put(settings, {"states.gnss_delay": "fixed"})
                jobs.append((k, settings, values.get("gnss.delay"), self._spans[k]))
        flights = self._replays.run(jobs)
        n = len(self._tapes)
        runs = [flights[i : i + n] for i in range(0, len(flights), n)]
        if self._reference is None:
            self._reference = runs[0]
        for run in runs:
            if not all(map(is_same, run, self._reference)):
                return -math.inf, None
        value = sum(map(log_likelihood, runs[0])) - 0.5 * float(
            np.sum(((u - self._start) / BELIEF) ** 2)
        )
        steps = STEP * self._slopes(u)
        return value, scores_of(runs[0], runs[1:], steps)
