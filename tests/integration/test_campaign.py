"""Campaigns as processes: a Dask cluster of which a worker is killed, and Ctrl-C in the middle."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from mavins.cli.main import main

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = [pytest.mark.jit, pytest.mark.slow]

LOGS = 8
SERIES = ["montecarlo", "quad_mission", "--runs", "8", "--duration", "40"]


def test_a_cluster_gives_the_same_bytes_though_a_worker_is_killed(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    assert main([*SERIES, "--jobs", "2", "--out", str(tmp_path / "here")]) == 0
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        killed: list[int] = []

        def kill() -> None:
            """Once the first runs are flown, in the middle of the next."""
            while not any("fly" in str(key) for keys in client.has_what().values() for key in keys):
                time.sleep(0.02)
            pids = client.run(os.getpid)
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        # a process of its own, as a user's: it knows no other client
        command = [
            sys.executable,
            "-m",
            "mavins",
            *SERIES,
            "--scheduler",
            cluster.scheduler_address,
        ]
        done = subprocess.run([*command, "--out", str(tmp_path / "there")], timeout=300)
        assert done.returncode == 0
        killer.join()
    assert len(killed) == 1
    for name in ("montecarlo.json", "runs.csv"):
        here, there = (tmp_path / place / name for place in ("here", "there"))
        assert here.read_bytes() == there.read_bytes()


def children_of(pid: int) -> list[int]:
    """Living processes whose parent this is."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = stat.read_text()
        except OSError:
            continue
        if int(text.rpartition(")")[2].split()[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def has_begun(pid: int) -> bool:
    """True once a worker leaves an interrupt to its parent."""
    status = Path(f"/proc/{pid}/status").read_text()
    (ignored,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigIgn:"))
    return bool(int(ignored, 16) >> (signal.SIGINT - 1) & 1)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="reads /proc")
@pytest.mark.parametrize("whole_group", [True, False])
def test_ctrl_c_ends_the_workers(tmp_path: Path, whole_group: bool) -> None:
    command = [sys.executable, "-m", "mavins", *SERIES[:2], "--runs", "500", "--jobs", "2"]
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        while len(workers := children_of(process.pid)) < 2:
            assert process.poll() is None
            time.sleep(0.05)
        while not all(map(has_begun, workers)):
            assert process.poll() is None
            time.sleep(0.05)
        if whole_group:
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does it
        else:
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
    assert not (tmp_path / "montecarlo.json").exists()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="reads /proc")
def test_an_interrupted_archive_goes_on_where_it_was(tmp_path: Path) -> None:
    sitl = [sys.executable, "-m", "sitl"]
    archive, out = tmp_path / "archive", tmp_path / "out"
    archive.mkdir()
    first = archive / "0.tlog"
    subprocess.run(
        [*sitl, "--record", str(first), "--duration", "30", "--speed", "max"], check=True
    )
    for k in range(1, LOGS):
        (archive / f"{k}.tlog").write_bytes(first.read_bytes())
    command = [sys.executable, "-m", "mavins", "replay", str(archive), "--jobs", "2"]
    with subprocess.Popen([*command, "--out", str(out)], start_new_session=True) as process:
        while not list(out.glob("*/replayed.json")):
            assert process.poll() is None
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(60) == 130
    kept = {path: path.stat().st_mtime_ns for path in out.glob("*/replayed.json")}
    assert 1 <= len(kept) < LOGS
    done = subprocess.run([*command, "--out", str(out)], check=True, capture_output=True, text=True)
    assert f"{LOGS} of {LOGS} replayed ({len(kept)} of them before)" in done.stdout
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(json.loads((out / "archive.json").read_text())["logs"]) == LOGS
