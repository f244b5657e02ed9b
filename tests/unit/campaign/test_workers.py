"""Jobs in worker processes: whoever dies, all that can be done is done, and nobody stays behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mavins.campaign.workers import Workers, spread
from mavins.errors import ConfigError


def square(x: int) -> tuple[int, int]:
    return x * x, os.getpid()


def dies(where: tuple[str, int]) -> int:
    """Kills its worker as often as it is told, and counts it in a file."""
    path, times = where
    with Path(path).open("a") as file:
        file.write("x")
    if len(Path(path).read_text()) <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return times


def fails(x: int) -> int:
    raise ConfigError(f"{x} is wrong")


def sleeps(x: int) -> int:
    time.sleep(x)
    return x


def test_all_jobs_are_done_elsewhere() -> None:
    found = dict(spread(square, range(20), Workers(2)))
    assert {k: outcome[0] for k, outcome in found.items() if outcome} == {
        k: k * k for k in range(20)
    }
    pids = {outcome[1] for outcome in found.values() if outcome}
    assert os.getpid() not in pids
    assert 1 <= len(pids) <= 2
    assert list(spread(square, [], Workers())) == []


def test_a_killed_workers_jobs_are_done_again(tmp_path: Path) -> None:
    jobs = [(str(tmp_path / str(k)), 1 if k == 3 else 0) for k in range(8)]
    assert dict(spread(dies, jobs, Workers(2))) == {k: job[1] for k, job in enumerate(jobs)}


def test_a_job_that_kills_whoever_takes_it_is_given_up(tmp_path: Path) -> None:
    jobs = [(str(tmp_path / str(k)), 99 if k == 0 else 0) for k in range(4)]
    assert dict(spread(dies, jobs, Workers(2))) == {0: None, 1: 0, 2: 0, 3: 0}


def test_an_error_ends_it_and_leaves_nobody() -> None:
    with pytest.raises(ConfigError, match="is wrong"):
        list(spread(fails, range(4), Workers(2)))
    assert multiprocessing.active_children() == []


def test_who_stops_early_leaves_nobody() -> None:
    began = time.monotonic()
    for k, _ in spread(sleeps, [0, 60, 60], Workers(2)):
        assert k == 0
        break
    assert multiprocessing.active_children() == []
    assert time.monotonic() - began < 30


def test_a_worker_does_not_outlive_its_parent(tmp_path: Path) -> None:
    """Killed outright, the parent cannot end its workers."""
    code = (
        "import os, sys, time, pathlib\n"
        "from mavins.campaign.workers import Workers, spread\n"
        "def task(x):\n"
        f"    pathlib.Path({str(tmp_path)!r}, str(os.getpid())).touch()\n"
        "    time.sleep(60)\n"
        "list(spread(task, [1, 2], Workers(2)))\n"
    )
    with subprocess.Popen([sys.executable, "-c", code]) as parent:
        while len(list(tmp_path.iterdir())) < 2:
            assert parent.poll() is None
            time.sleep(0.05)
        parent.kill()
    pids = [int(path.name) for path in tmp_path.iterdir()]
    for _ in range(200):
        if not any(Path(f"/proc/{pid}").exists() for pid in pids):
            return
        time.sleep(0.05)
    pytest.fail(f"workers are left: {pids}")


def test_how_many() -> None:
    with pytest.raises(ConfigError, match="--jobs 0"):
        Workers(0)


def test_no_scheduler_there(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("mavins.campaign.workers.ANSWER_S", 0.5)
    with pytest.raises(ConfigError, match=r"--scheduler tcp://127\.0\.0\.1:1: no Dask"):
        list(spread(square, [1], Workers(scheduler="tcp://127.0.0.1:1")))
