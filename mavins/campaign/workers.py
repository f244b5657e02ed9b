"""Jobs to worker processes, here or on a Dask cluster, so that their number and their deaths change nothing.

A job whose worker is killed is done again; one that kills whoever takes it is given up, and the others go on.
Decision: docs/decisions/0022-campaigns-and-their-workers.md.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from typing import Any, Final, TypeVar

from mavins.errors import ConfigError

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")

ROUNDS: Final = 3
"""How often a job is tried whose worker dies; in the last round each has a worker to itself."""
PATIENCE_S: Final = 10.0
"""How long a worker may take to tidy up."""
ANSWER_S: Final = 10.0
"""How long a Dask scheduler may take to answer."""
LOST: Final = f"its worker was killed {ROUNDS} times (out of memory?)"


@dataclass(frozen=True, slots=True)
class Workers:
    """Where jobs are done: in `processes` of this computer (None: one for each core), or on a Dask `scheduler`."""

    processes: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.processes is not None and self.processes < 1:
            raise ConfigError(f"--jobs {self.processes} makes no sense: give 1 or more")


def spread(
    task: Callable[[Job], Outcome], jobs: Sequence[Job], workers: Workers
) -> Generator[tuple[int, Outcome | None]]:
    """Place and outcome of every job as they are done; None for one that was given up.

    `task` is a function of a module, and an error that it raises ends the series. However the iteration ends, no
    worker is left.
    """
    if workers.scheduler is not None:
        return _on_cluster(task, jobs, workers.scheduler)
    return _here(task, jobs, min(workers.processes or _cores(), max(1, len(jobs))))


def _cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def ready(filter_name: str) -> None:
    """Have a filter's kernels, in this process: what is forked from it has them too."""
    from mavins.warmup import compile_all

    compile_all(lambda line: print(line, file=sys.stderr, flush=True), filter_name)


def _here(
    task: Callable[[Job], Outcome], jobs: Sequence[Job], processes: int
) -> Generator[tuple[int, Outcome | None]]:
    left = dict(enumerate(jobs))
    for _ in range(ROUNDS - 1):
        for k, outcome in _one_pool(task, left, processes):
            del left[k]
            yield k, outcome
        if not left:
            return
    for k, job in left.items():
        done = list(_one_pool(task, {k: job}, 1))
        yield done[0] if done else (k, None)


def _one_pool(
    task: Callable[[Job], Outcome], jobs: dict[int, Job], processes: int
) -> Iterator[tuple[int, Outcome]]:
    """Places and outcomes until all are done, or a worker has died."""
    others = set(multiprocessing.active_children())
    # a fork has the kernels loaded and compiled; elsewhere than on Linux it is not safe
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    pool = ProcessPoolExecutor(processes, context, _begin)
    try:
        places = {pool.submit(_do, task, job): k for k, job in jobs.items()}
        for future in as_completed(places):
            yield places[future], future.result()
        pool.shutdown()
    except BrokenProcessPool:
        pass
    finally:
        _end(pool, [p for p in multiprocessing.active_children() if p not in others])


class _EndedError(BaseException):
    """A worker is told to end in the middle of a job, which may still tidy up."""


_busy = False


def _begin() -> None:
    """A worker's first act: an interrupt is its parent's to handle, whose end it does not outlive."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _told_to_end)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=follow, daemon=True).start()


def _told_to_end(number: int, frame: object) -> None:
    if _busy:
        raise _EndedError
    os._exit(1)


def _do(task: Callable[[Job], Outcome], job: Job) -> Outcome:
    """Do a job in a worker."""
    global _busy
    _busy = True
    try:
        return task(job)
    except _EndedError:
        os._exit(1)
    finally:
        _busy = False


def _end(pool: ProcessPoolExecutor, processes: Sequence[BaseProcess]) -> None:
    """End a pool's workers in the middle of what they do."""
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(PATIENCE_S)
        process.kill()
    pool.shutdown(cancel_futures=True)


def _on_cluster(
    task: Callable[[Job], Outcome], jobs: Sequence[Job], scheduler: str
) -> Generator[tuple[int, Outcome | None]]:
    import distributed

    try:
        client = distributed.Client(scheduler, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"--scheduler {scheduler}: no Dask scheduler there ({reason})") from None
    with client:
        # the scheduler does a job again whose worker is gone, as often as its own `allowed-failures` says
        futures = client.map(task, jobs, pure=False)
        places = {future.key: k for k, future in enumerate(futures)}
        try:
            # the loop of this client: the default one may be another's, or there may be none
            for future in distributed.as_completed(futures, loop=client.loop):
                yield places[future.key], _outcome(future)
                future.release()
        finally:
            client.cancel(futures)


def _outcome(future: Any) -> Any:
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return None
