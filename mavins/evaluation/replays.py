"""Whole logs run again with other settings, in as many processes as are wanted; a log is handed to each only once."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from types import TracebackType
from typing import Final

from mavins.estimator.settings import Settings
from mavins.evaluation.likelihood import Flight, between, innovations
from mavins.evaluation.tape import Tape


@dataclass(frozen=True, slots=True)
class Job:
    """Which tape, with which settings and age of its fixes (s), and which stamps count (None: all).

    Of its fixes and headings in the span, every so many-th is fed (`thinning`).
    """

    tape: int
    settings: Settings
    delay: float
    thinning: tuple[int, int] = (1, 1)
    span: tuple[int, int] | None = None


TAIL_US: Final = 2_000_000
"""A run goes on for so long after the last stamp that counts: a fix may be late."""

_tapes: list[Tape] = []
_filter = ""


def cores() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Replays:
    """Runs jobs; use as a context."""

    def __init__(self, tapes: Sequence[Tape], filter_name: str, jobs: int) -> None:
        self.count = 0
        self._start = (list(tapes), filter_name)
        # where processes can be forked, they have the logs already
        kind = "fork" if "fork" in multiprocessing.get_all_start_methods() else None
        context = multiprocessing.get_context(kind)
        self._pool = (
            ProcessPoolExecutor(jobs, context, _begin, (*self._start, True)) if jobs > 1 else None
        )
        if self._pool is None:
            _begin(*self._start, False)

    def __enter__(self) -> Replays:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=kind is None, cancel_futures=True)

    def run(self, jobs: Sequence[Job]) -> list[Flight]:
        """The innovations of each job."""
        self.count += len(jobs)
        return list(map(_run, jobs) if self._pool is None else self._pool.map(_run, jobs))


def _begin(tapes: list[Tape], filter_name: str, aside: bool) -> None:
    global _tapes, _filter
    _tapes, _filter = tapes, filter_name
    _prepared.cache_clear()
    if aside:
        # Ctrl-C is for the one that started this
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@cache
def _prepared(tape: int, thinning: tuple[int, int], span: tuple[int, int] | None) -> Tape:
    if span is None:
        return _tapes[tape]
    every = {"feed_gnss": thinning[0], "feed_heading": thinning[1]}
    # the start needs its headings
    return _tapes[tape].until(span[1] + TAIL_US).thinned(every, span[0])


def _run(job: Job) -> Flight:
    tape = _prepared(job.tape, job.thinning, job.span).delayed(job.delay)
    flight = innovations(job.settings, _filter, tape)
    return flight if job.span is None else between(flight, *job.span)
