"""Noises and the delay of GNSS from flights alone: those under which the innovations are likeliest.

Whole logs are run again with other settings, the steps are those of Fisher's scoring within a trust region, and what
is found must also make the last part of each log likelier, which the fit has not seen. No truth is looked at.

Source: Mehra (1970); Gupta and Mehra (1974) for the scores. Theory: docs/theory/tuning.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from mavins.aiding import gnss_position, gnss_velocity, heading
from mavins.errors import MavinsError
from mavins.evaluation.likelihood import (
    Flight,
    between,
    bounds_of,
    is_same,
    lasting,
    log_likelihood,
)
from mavins.evaluation.replays import Job, Replays
from mavins.evaluation.scoring import Scores, scores_of
from mavins.evaluation.tape import Tape
from mavins.evaluation.tunable import PARAMETERS, Parameter, first_values, opened, put, tuned
from mavins.types import FloatArray

SETTLE_US: Final = 10_000_000
"""The alignment's errors are not the sensors': measurements count from this long after the first."""
EDGE_US: Final = 2_000_000
"""At the end, whether a late fix still finds its IMU samples hangs on its delay: the last ones do not count."""
HELD_OUT: Final = 0.3
"""The last part of each log, which the fit does not see."""
STEP: Final = 0.01
MAX_STEPS: Final = 20
FIRST_STEPS: Final = 6
"""So many steps show whether errors last."""
ENOUGH: Final = 0.02
"""The search ends where the next step promises less than this of log p."""
BELIEF: Final = 2.3
"""1-sigma of a weak belief in the value that was there, a factor of ten: what a log says nothing of stays near it."""
UNKNOWN: Final = 1.0
"""A parameter whose scaled 1-sigma is larger is hardly seen in the logs."""
LASTING: Final = 0.15
"""Innovations that are correlated by more than this belong to errors that last longer than from one to the next."""
FEWEST: Final = 40
"""So many measurements of a kind are left at least."""
MOST_ROUNDS: Final = 4


@dataclass(frozen=True, slots=True)
class Found:
    """A parameter before and after, with its 95 % interval; one not `known` from the logs stays near `before`."""

    parameter: Parameter
    before: float
    after: float
    interval: tuple[float, float]
    known: bool
    at_bound: bool


@dataclass(frozen=True, slots=True)
class Compared:
    """log p per measurement, before and after, of so many."""

    before: float
    after: float
    count: int


@dataclass(frozen=True, slots=True)
class Tuning:
    """What was found, how likely the fitted and the held-out parts are with it, and what it took.

    Every `thinning`-th fix and heading was judged, since errors last so long.
    """

    found: tuple[Found, ...]
    fit: Compared
    held_out: Compared
    thinning: tuple[int, int]
    replays: int

    @property
    def values(self) -> dict[str, float]:
        """What was found, by dotted path."""
        return {f.parameter.path: f.after for f in self.found}

    @property
    def accepted(self) -> bool:
        """True where the part of the logs that was not fitted has become likelier too."""
        return self.held_out.after > self.held_out.before


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
        flights = replays.run(
            [Job(k, opened(tape.settings), tape.delay()) for k, tape in enumerate(tapes)]
        )
        if not all(flights):
            raise MavinsError("a log yields no estimate to tune by: see why with mavins replay")
        seen = {aiding for flight in flights for aiding, _ in flight}
        parameters = [
            p
            for p in PARAMETERS
            if (p.aiding or gnss_position.NAME) in seen and (everything or not p.walk)
        ]
        first = first_values(tapes[0], parameters)
        likelihood = Likelihood(replays, tapes, [_window(f) for f in flights], parameters)
        thinning, last = (1, 1), np.empty(0)
        for done in range(MOST_ROUNDS):
            scales = [math.sqrt(thinning[p.thinned]) if p.thinned >= 0 else 1.0 for p in parameters]
            start = np.array(
                [p.inner(first[p.path] / s) for p, s in zip(parameters, scales, strict=True)]
            )
            likelihood.begin(thinning, start)
            last, sigmas = climb(likelihood, last if len(last) else start, FIRST_STEPS)
            progress((1 + done) / (1 + MOST_ROUNDS))
            wider = next_thinning(likelihood.flights(last), thinning)
            if wider == thinning or done + 1 == MOST_ROUNDS:
                break
            thinning = wider
        last, sigmas = climb(likelihood, last, MAX_STEPS)
        progress(1.0)
        fit, held_out = likelihood.compared(start, last)
    found = []
    for p, s, u, sigma in zip(parameters, scales, last, sigmas.tolist(), strict=True):
        value = p.value(u)
        low, high = (s * bound for bound in p.interval(value, sigma))
        after = float(f"{min(max(s * value, p.low), p.high):.4g}")
        known, at_bound = sigma < UNKNOWN, p.is_at_bound(value)
        found.append(Found(p, first[p.path], after, (low, high), known, at_bound))
    return Tuning(tuple(found), fit, held_out, thinning, replays.count)


def next_thinning(flights: Sequence[Flight], thinning: tuple[int, int]) -> tuple[int, int]:
    """How many fixes and headings to pass over for what is left to be independent."""
    left = (
        max(lasting(flights, gnss_position.NAME), lasting(flights, gnss_velocity.NAME)),
        lasting(flights, heading.NAME),
    )
    counts = [
        sum(len(part.stamps) for f in flights for (name, _), part in f.items() if name == aiding)
        for aiding in (gnss_position.NAME, heading.NAME)
    ]
    wider = []
    for correlation, count, now in zip(left, counts, thinning, strict=True):
        factor = 1
        if correlation > max(LASTING, 2.0 / math.sqrt(max(count, 1))):
            wanted = math.ceil(math.log(LASTING) / math.log(min(correlation, 0.95)))
            factor = max(1, min(max(2, wanted), count // FEWEST))
        wider.append(now * factor)
    return wider[0], wider[1]


def _window(flight: Flight) -> tuple[int, int]:
    start, end = bounds_of(flight)
    return start + SETTLE_US, end - EDGE_US


def _middle(window: tuple[int, int]) -> int:
    """Where the held-out part begins."""
    return round(window[1] - HELD_OUT * (window[1] - window[0]))


class Likelihood:
    """log p of the fitted parts as a function of the parameters' inner coordinates u (n,), with a weak belief."""

    def __init__(
        self,
        replays: Replays,
        tapes: Sequence[Tape],
        windows: Sequence[tuple[int, int]],
        parameters: Sequence[Parameter],
    ) -> None:
        self._replays = replays
        self._tapes = tapes
        self._windows = windows
        self._parameters = parameters
        self._thinning = (1, 1)
        self._believed = np.zeros(len(parameters))
        self._known: dict[bytes, tuple[float, Scores | None, list[Flight]]] = {}

    def begin(self, thinning: tuple[int, int], believed: FloatArray) -> None:
        """Judge so many of the fixes and headings from now on; `believed` (n,) is where a log that is mute leaves u."""
        self._thinning, self._believed = thinning, believed
        self._known.clear()
        self._reference: list[Flight] | None = None

    def value(self, u: FloatArray) -> float:
        """-(log p + log belief)."""
        return -self._at(u)[0]

    def gradient(self, u: FloatArray) -> FloatArray:
        """Of `value`."""
        slope: FloatArray = -self._slopes(u) * self.scores(u).gradient
        return slope + (u - self._believed) / BELIEF**2

    def information(self, u: FloatArray) -> FloatArray:
        """What stands for the second derivative of `value`."""
        slopes = self._slopes(u)
        known: FloatArray = slopes[:, None] * self.scores(u).information * slopes
        return known + np.eye(len(u)) / BELIEF**2

    def scores(self, u: FloatArray) -> Scores:
        """The derivatives of log p by the scaled parameters."""
        scores = self._at(u)[1]
        if scores is None:
            raise MavinsError("the measurements that are judged change from run to run: not tuned")
        return scores

    def flights(self, u: FloatArray) -> list[Flight]:
        """The innovations that are fitted."""
        return self._at(u)[2]

    def compared(self, one: FloatArray, two: FloatArray) -> tuple[Compared, Compared]:
        """Of the fitted and of the held-out parts: log p per measurement at two points."""
        jobs = [
            self._job(k, u, window) for u in (one, two) for k, window in enumerate(self._windows)
        ]
        runs = self._replays.run(jobs)
        n = len(self._windows)
        both = runs[:n], runs[n:]
        middles = [_middle(window) for window in self._windows]
        fit = [(a, m) for (a, _), m in zip(self._windows, middles, strict=True)]
        held = [(m, b) for (_, b), m in zip(self._windows, middles, strict=True)]
        return _compared(*both, fit), _compared(*both, held)

    def _slopes(self, u: FloatArray) -> FloatArray:
        return np.array([p.slope(k) for p, k in zip(self._parameters, u, strict=True)])

    def _at(self, u: FloatArray) -> tuple[float, Scores | None, list[Flight]]:
        key = u.tobytes()
        if key not in self._known:
            self._known[key] = self._evaluate(u)
        return self._known[key]

    def _job(self, k: int, u: FloatArray, span: tuple[int, int]) -> Job:
        """Log k under the parameters at u, the delay being what it is said to be."""
        tape = self._tapes[k]
        values = {p.path: p.value(at) for p, at in zip(self._parameters, u, strict=True)}
        delay = values.get("gnss.delay", tape.delay())
        settings = put(opened(tuned(tape.settings, values)), {"states.gnss_delay": "fixed"})
        return Job(k, settings, delay, self._thinning, span)

    def _evaluate(self, u: FloatArray) -> tuple[float, Scores | None, list[Flight]]:
        """All of it at once: the neighbours that give the derivatives run beside the point itself."""
        points = [u, *(u + STEP * row for row in np.eye(len(u)))]
        spans = [(window[0], _middle(window)) for window in self._windows]
        jobs = [self._job(k, point, span) for point in points for k, span in enumerate(spans)]
        flights = self._replays.run(jobs)
        n = len(spans)
        runs = [flights[i : i + n] for i in range(0, len(flights), n)]
        if self._reference is None:
            self._reference = runs[0]
        if not all(
            is_same(f, r) for run in runs for f, r in zip(run, self._reference, strict=True)
        ):
            return -math.inf, None, runs[0]
        value = sum(map(log_likelihood, runs[0]))
        value -= 0.5 * float(np.sum(((u - self._believed) / BELIEF) ** 2))
        return value, scores_of(runs[0], runs[1:], STEP * self._slopes(u)), runs[0]


def climb(likelihood: Likelihood, start: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Go up from here; returns where it ended (n,) and the scaled parameters' 1-sigma (n,) there."""

    def look(intermediate_result: OptimizeResult) -> None:
        u = intermediate_result.x
        g = likelihood.gradient(u)
        if 0.5 * g @ np.linalg.solve(likelihood.information(u), g) < ENOUGH:
            raise StopIteration

    result = minimize(
        likelihood.value,
        start,
        jac=likelihood.gradient,
        hess=likelihood.information,
        method="trust-exact",
        callback=look,
        options={
            "initial_trust_radius": 1.0,
            "max_trust_radius": 2.0,
            "maxiter": steps,
            "gtol": 0.0,
        },
    )
    return result.x, likelihood.scores(result.x).sigmas()


def _compared(
    before: Sequence[Flight], after: Sequence[Flight], spans: Sequence[tuple[int, int]]
) -> Compared:
    """log p per measurement of two runs; one that has lost measurements has none."""
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
    return Compared(one, two, most)
