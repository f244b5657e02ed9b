"""A replay that is stopped, or has no room, leaves nothing that passes for a result; and what a dry run says."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.config import Config
from mavins.estimates import Result
from mavins.replay import ReplayOptions, replay
from mavins.results import write_text

pytestmark = pytest.mark.jit


QUICK = ("-q", "--no-report")


def flight(folder: Path, seconds: int) -> Path:
    """A vehicle that stands, as a folder of CSV files: 200 Hz IMU, 5 Hz fixes, 10 Hz headings."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    t_us = 1_000_000 + 5_000 * np.arange(200 * seconds)
    readings = rng.normal(0.0, 1e-3, (len(t_us), 6))
    readings[:, 2] -= 9.808
    header = "t_us,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    lines = [
        f"{t},{','.join(f'{value:.6f}' for value in row)}"
        for t, row in zip(t_us.tolist(), readings.tolist(), strict=True)
    ]
    (folder / "imu.csv").write_text("\n".join([header, *lines]) + "\n")
    fixes = [f"{t},47.4,8.5,500,0,0,0" for t in t_us[::40].tolist()]
    header = "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d"
    (folder / "gnss.csv").write_text("\n".join([header, *fixes]) + "\n")
    (folder / "heading.csv").write_text(
        "\n".join(["t_us,yaw", *(f"{t},0.5" for t in t_us[::20].tolist())]) + "\n"
    )
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture
def former(tmp_path: Path) -> tuple[Path, dict[str, bytes]]:
    """A whole result of an earlier run, and what is in it."""
    out = tmp_path / "result"
    for name in ("summary.json", "eskf/estimates.csv", "eskf/innovations.csv", "notes.txt"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(f"former {name}")
    return out, contents(out)


def replaying(log: Path, out: Path, **options: Any) -> subprocess.Popen[str]:
    options |= {"stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-m", "mavins", "replay", str(log), "--out", str(out), *QUICK]
    return subprocess.Popen(command, **options)


def test_ctrl_c_leaves_what_was_there(
    tmp_path: Path, former: tuple[Path, dict[str, bytes]]
) -> None:
    out, before = former
    log = flight(tmp_path / "flight", 600)
    # whoever stops it goes first on a busy machine
    with replaying(log, out, preexec_fn=lambda: os.nice(19)) as process:
        try:
            until = time.monotonic() + 120.0
            # some rows are out, and many are to come
            while not any(path.stat().st_size > 100_000 for path in part_files(out)):
                assert process.poll() is None, "it was over before it could be stopped"
                assert time.monotonic() < until
                time.sleep(0.002)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=60.0)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in said
    assert contents(out) == before
    assert sorted(path.name for path in out.iterdir()) == ["eskf", "notes.txt", "summary.json"]


def part_files(out: Path) -> list[Path]:
    with contextlib.suppress(FileNotFoundError):
        return list(out.glob(".part-*/eskf/estimates.csv"))
    return []


def test_a_full_disk_leaves_what_was_there(
    tmp_path: Path, former: tuple[Path, dict[str, bytes]]
) -> None:
    out, before = former
    limit = 200_000

    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    log = flight(tmp_path / "flight", 60)
    with replaying(log, out, preexec_fn=little_room) as process:
        _, said = process.communicate(timeout=120.0)
    assert process.returncode == 2
    assert said.startswith(f"mavins: cannot write {out / 'eskf' / 'estimates.csv'}: ")
    assert said.count("\n") == 1
    assert contents(out) == before
    assert not list(out.glob(".*"))


def test_a_result_takes_the_place_of_a_former_one(
    tmp_path: Path, former: tuple[Path, dict[str, bytes]]
) -> None:
    out, before = former
    for name in ("eskf/smoothed.csv", "report.html"):
        (out / name).write_text("former")
    log = flight(tmp_path / "flight", 20)
    command = ["replay", str(log), "--out", str(out), *QUICK, "--export"]
    assert main([*command, "tum,gpx,tlog"]) == 0
    after = contents(out)
    assert after["notes.txt"] == before["notes.txt"]
    assert json.loads(after["summary.json"])["rows"] > 0
    assert set(after) == {
        "summary.json",
        "notes.txt",
        *(
            f"eskf/{name}"
            for name in (
                "estimates.csv",
                "innovations.csv",
                "evidence.npz",
                "config.yaml",
                "estimates.tum",
                "track.gpx",
                "output.tlog",
            )
        ),
    }
    assert main(["export", str(out), "--to", "kml", "-q"]) == 0
    assert (out / "eskf" / "track.kml").exists()
    assert main([*command, "none"]) == 0
    # an export of what was replaced would pass for one of what is there now
    assert set(contents(out)) == {
        name for name in after if name.rpartition(".")[2] not in ("tum", "gpx", "tlog")
    }
    assert contents(out)["eskf/estimates.csv"] == after["eskf/estimates.csv"]


def test_the_report_is_part_of_what_is_whole(tmp_path: Path) -> None:
    """It is there with the rest, or nothing is."""
    log, out = flight(tmp_path / "flight", 20), tmp_path / "result"

    def report(_: Result, aside: Path) -> None:
        write_text(aside / "report.html", "whole")

    def stop(result: Result, aside: Path) -> None:
        report(result, aside)
        assert not (out / "summary.json").exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replay(log, out, Config(), ReplayOptions(), finish=stop)
    assert not out.exists()
    replay(log, out, Config(), ReplayOptions(), finish=report)
    assert {path.name for path in out.iterdir()} == {"summary.json", "report.html", "eskf"}


def test_a_dry_run_says_what_would_be_used_and_runs_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = flight(tmp_path / "flight", 20), tmp_path / "result"
    options = ["--out", str(out), "--dry-run", "--smooth", "--export", "kml,tlog"]
    assert main(["replay", str(log), *options]) == 0
    said = capsys.readouterr().out
    for line in (
        f"{log}: csv_folder, 20.0 s",
        "imu: imu.csv, 4000 (200.1 Hz)",
        "gnss: gnss.csv, 100 (5.0 Hz)",
        "heading: heading.csv, 200 (10.0 Hz)",
        "gnss.delay: auto, here 0",
        "delay of GNSS: 0 s, estimated from there on",
        f"would write {out / 'summary.json'}, and into {out / 'eskf'}: estimates.csv, innovations.csv, "
        "evidence.npz, config.yaml, smoothed.csv, track.kml, output.tlog",
    ):
        assert line in said.splitlines()
    assert not out.exists()
    assert main(["replay", str(log), "--dry-run"]) == 0


def test_a_missing_extra_is_named_only_where_it_was_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavins.exports.find_spec", lambda name: None)
    log, out = str(flight(tmp_path / "flight", 20)), str(tmp_path / "result")
    assert main(["replay", log, "--out", out, "--export", "parquet"]) == 2
    assert "pip install 'mavins[export]'" in capsys.readouterr().err
    assert main(["replay", log, "--dry-run"]) == 0
    assert "parquet" not in capsys.readouterr().out


def test_nowhere_to_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(tmp_path)]) == 2
    assert "--out DIR" in capsys.readouterr().err
    if os.geteuid() == 0:
        return
    tmp_path.chmod(0o500)
    assert main(["replay", str(tmp_path), "--out", str(tmp_path / "new")]) == 2
