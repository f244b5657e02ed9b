"""A folder of logs: what is one, what is done again, and that a bad log takes no other along."""

from __future__ import annotations

import csv
import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mavins.campaign import archive as archives
from mavins.campaign.archive import (
    DONE,
    FAILED,
    NO_LOG,
    LogJob,
    finished,
    is_archive,
    jobs_of,
    logs_in,
    replay_archive,
    table_lines,
    write_archive,
)
from mavins.campaign.workers import Workers
from mavins.cli.main import main
from mavins.config import Config, load
from mavins.errors import LogFormatError, OutputError
from mavins.replay import ReplayOptions

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

SECONDS = 6


def standing(path: Path, seed: int) -> Path:
    """A vehicle that stands, as a folder of CSV files."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, SECONDS * 1_000_000, 20_000)
    f = rng.normal(size=(len(t), 3)) * 0.02 - [0.0, 0.0, 9.8065]
    w = rng.normal(size=(len(t), 3)) * 1e-3
    head = "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d"
    rows = zip(t, f, w, strict=True)
    tables = {
        "imu": [
            "t_us,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z",
            *(",".join(map(str, (k, *a, *b))) for k, a, b in rows),
        ],
        "gnss": [
            f"{head},fix_type,satellites",
            *(f"{k},45.0,-93.0,250.0,0,0,0,3,9" for k in t[::10]),
        ],
        "heading": ["t_us,yaw", *(f"{k},0.5" for k in t[::10])],
        "reference": [
            f"{head},roll,pitch,yaw",
            *(f"{k},45.0,-93.0,250.0,0,0,0,0,0,0.5" for k in t[::5]),
        ],
    }
    path.mkdir(parents=True)
    for name, lines in tables.items():
        (path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """Two logs, of which one lies deeper, a damaged one, a text, and what is none of our business."""
    folder = tmp_path / "archive"
    standing(folder / "a", 1)
    standing(folder / "2024" / "b", 2)
    broken = standing(folder / "broken", 3)
    (broken / "imu.csv").write_text("t_us,accel_x\n1,x\n")
    (folder / "notes.txt").write_text("flew well\n")
    (folder / ".hidden").write_text("")
    earlier = folder / "results"
    earlier.mkdir()
    (earlier / "summary.json").write_text("{}")
    (earlier / "estimates.txt").write_text("no log")
    return folder


def names(jobs: list[LogJob]) -> list[str]:
    return [job.name for job in jobs]


def test_which_logs_there_are(archive: Path, tmp_path: Path) -> None:
    assert is_archive(archive)
    assert not is_archive(archive / "a")
    assert not is_archive(archive / "notes.txt")
    out = archive / "out"
    standing(out / "left", 4)
    jobs = jobs_of(archive, out, Config(), ReplayOptions())
    assert names(jobs) == ["2024/b", "a", "broken", "notes.txt"]
    assert jobs[0].out == out / "2024" / "b"
    empty = tmp_path / "empty"
    empty.mkdir()
    assert list(logs_in(empty, out)) == []
    with pytest.raises(LogFormatError, match="is no log, and holds none"):
        jobs_of(empty, out, Config(), ReplayOptions())
    with pytest.raises(OutputError, match="the archive itself"):
        jobs_of(archive, archive, Config(), ReplayOptions())


def test_one_table_over_all(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["replay", str(archive), "--out", str(out), "--jobs", "2"]) == 1
    text = capsys.readouterr().out
    assert "2 of 4 replayed (0 of them before)" in text
    with (out / "archive.csv").open() as file:
        rows = {row["log"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["2024/b", "a", "broken", "notes.txt"]
    assert [row["status"] for row in rows.values()] == [DONE, DONE, FAILED, NO_LOG]
    assert "imu.csv" in rows["broken"]["reason"]
    assert "imu.csv" in next(line for line in text.splitlines() if line.startswith("broken"))
    summary = json.loads((out / "a" / "summary.json").read_text())
    rms = summary["reference"]["rms"]
    assert float(rows["a"]["rms_vertical_m"]) == pytest.approx(rms["pos_m"][2], rel=1e-5)
    assert float(rows["a"]["rms_yaw_deg"]) == pytest.approx(rms["att_deg"][2], rel=1e-5)
    assert rows["a"]["judged_by"] == "reference.csv"
    told = json.loads((out / "archive.json").read_text())
    assert told["logs"][1]["aiding"] == summary["aiding"]
    assert (out / "2024" / "b" / "eskf" / "estimates.csv").exists()


def test_another_number_of_workers_changes_nothing(archive: Path, tmp_path: Path) -> None:
    for jobs in ("1", "2"):
        main(["-q", "replay", str(archive), "--out", str(tmp_path / jobs), "--jobs", jobs])
    for name in ("archive.csv", "archive.json", "a/eskf/estimates.csv", "a/eskf/innovations.csv"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


def test_what_is_finished_is_not_done_again(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, options = load(), ReplayOptions()
    out = tmp_path / "out"
    jobs = jobs_of(archive, out, config, options)[:2]
    first = replay_archive(jobs, Workers(1))
    assert [one.status for one in first] == [DONE, DONE]
    assert replay_archive(jobs, Workers(1)) == first
    write_archive(out, archive, first)
    table = (out / "archive.csv").read_bytes()

    done: list[str] = []
    monkeypatch.setattr(archives, "spread", lambda task, left, workers: noted(done, left))

    def again(changed: list[LogJob]) -> list[str]:
        done.clear()
        replay_archive(changed, Workers(1))
        return done.copy()

    assert again(jobs) == []
    other = load(None, {"gnss.delay": 0.1})
    assert again(jobs_of(archive, out, other, options)[:2]) == ["2024/b", "a"]
    faster = dataclasses.replace(options, rate=10.0)
    assert again(jobs_of(archive, out, config, faster)[:2]) == ["2024/b", "a"]
    (out / "a" / "summary.json").write_text('{"rows": 1')  # an interruption, or a full disk
    assert again(jobs) == ["a"]
    (archive / "2024" / "b" / "gnss.csv").touch()
    assert again(jobs) == ["2024/b", "a"]
    monkeypatch.undo()
    write_archive(out, archive, replay_archive(jobs, Workers(1)))
    assert (out / "archive.csv").read_bytes() == table


def noted(done: list[str], left: list[LogJob]):  # type: ignore[no-untyped-def]
    done += names(left)
    yield from ()


def test_a_result_that_was_begun_is_not_finished(archive: Path, tmp_path: Path) -> None:
    job = jobs_of(archive, tmp_path / "out", Config(), ReplayOptions())[1]
    assert finished(job) is None
    assert archives.replay_one(job).status == DONE
    assert finished(job) is not None
    (archive / "a" / "imu.csv").write_text("t_us,accel_x\n1,x\n")
    assert archives.replay_one(job).status == FAILED
    assert finished(job) is None
    shutil.rmtree(job.out)
    assert finished(job) is None


def test_a_mistake_of_ours_is_told_and_kept_apart(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(*_: object) -> None:
        raise ZeroDivisionError("of all things")

    monkeypatch.setattr(archives, "replay", wrong)
    job = jobs_of(archive, tmp_path, Config(), ReplayOptions())[1]
    one = archives.replay_one(job)
    assert one.reason == "ZeroDivisionError: of all things"
    assert any("of all things" in line for line in table_lines([one]))


def test_jobs_are_for_archives(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = str(archive / "a"), str(tmp_path / "out")
    assert main(["replay", log, "--out", out, "--jobs", "2"]) == 2
    assert "is one log" in capsys.readouterr().err
