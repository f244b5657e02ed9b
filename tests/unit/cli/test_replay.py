"""`mavins replay` for a user who asks for what cannot be, and what it prints when it can."""

from __future__ import annotations

import gzip
import lzma
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.cli.replay import lines_of
from mavins.logs.tlog import TlogWriter
from mavins.mavlink.codec import frame, heartbeat, highres_imu
from mavins.types import ImuSample


@pytest.fixture
def no_imu(tmp_path: Path) -> Path:
    """A log of a vehicle that only sends heartbeats."""
    path = tmp_path / "heartbeats.tlog"
    with TlogWriter(path) as log:
        for k in range(50):
            log.write(1_790_000_000_000_000 + k * 1_000_000, frame(heartbeat(2, 12), 1, 1, k))
    return path


@pytest.fixture
def with_imu(tmp_path: Path) -> Path:
    """A log of vehicle 3, whose IMU says of every sample that nothing in it is new."""
    path = tmp_path / "imu.tlog"
    with TlogWriter(path) as log:
        for k in range(50):
            sample = ImuSample(1_000_000 + k * 4_000, np.array([0.0, 0.0, -9.8]), np.zeros(3))
            packet = frame(highres_imu(sample, fields_updated=0), 3, 1, k)
            log.write(1_790_000_000_000_000 + k * 4_000, packet)
    return path


def refused(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert main(["replay", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("mavins: ")
    assert said.err.count("\n") == 1
    return said.err


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("flight.tlog", b"", "empty"),
        ("flight.tlog", bytes(range(256)) * 40, "not a MAVLink .tlog"),
        ("flight.tlog", b"PK\x03\x04" + bytes(100), "zip"),
        ("flight.ulg", b"ULog\x01\x12\x35" + bytes(100), ".ulg"),
        ("flight.bin", b"\xa3\x95\x80" + bytes(100), ".bin"),
        ("flight.tlog.gz", b"\x1f\x8b" + bytes(10), "damaged"),
        ("flight.tlog.xz", b"\xfd7zXZ\x00" + bytes(20), "damaged"),
        ("flight.tlog.gz", gzip.compress(b"", mtime=0), "empty"),
        ("flight.tlog.xz", lzma.compress(b"nothing of use"), "not a MAVLink .tlog"),
    ],
)
def test_a_log_that_cannot_be_read(
    name: str, content: bytes, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / name
    log.write_bytes(content)
    line = refused(capsys, str(log), "--out", str(tmp_path / "out"))
    assert name in line
    assert said in line
    assert not (tmp_path / "out").exists()


def test_a_log_that_is_not_there_or_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    assert "none.tlog" in refused(capsys, str(tmp_path / "none.tlog"), "--out", out)
    assert str(tmp_path) in refused(capsys, str(tmp_path), "--out", out)


def test_a_log_without_an_imu(
    no_imu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, str(no_imu), "--out", str(tmp_path / "out"))
    assert "no IMU messages" in line
    assert "mavins info" in line
    assert not (tmp_path / "out").exists()


def test_a_vehicle_that_is_not_in_the_log(
    with_imu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = (str(with_imu), "--out", str(tmp_path / "out"))
    assert "vehicle 5 sends no IMU" in refused(capsys, *options, "--sysid", "5")
    assert not (tmp_path / "out").exists()


@pytest.mark.jit
def test_a_log_with_an_imu_that_is_of_no_use(
    with_imu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, str(with_imu), "--out", str(tmp_path / "out"))
    assert "no usable IMU messages of vehicle 3" in line


def test_an_output_folder_that_cannot_be_made(
    with_imu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    line = refused(capsys, str(with_imu), "--out", str(tmp_path / "file" / "out"))
    assert str(tmp_path / "file") in line
    assert "another" in line


def test_bad_settings_and_bounds(
    no_imu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("gnss:\n  gate: wide\n")
    options = (str(no_imu), "--out", str(tmp_path / "out"))
    assert "gnss.gate" in refused(capsys, *options, "--config", str(settings))
    assert "--start" in refused(capsys, *options, "--start", "20", "--end", "10")
    assert "--rate" in refused(capsys, *options, "--rate", "-1")


def test_lines_for_people() -> None:
    summary = {
        "filter": "eskf",
        "rows": 0,
        "imu_samples": 12,
        "log_s": 3.0,
        "cpu_s": 0.01,
        "times_real_time": 300.0,
        "health": "aligning",
        "reason": "no heading source",
        "aiding": {
            "heading": {"accepted": 3, "rejected": {"gate": 2}, "nis_per_row": 0.5},
            "gnss_position": {"accepted": 0, "rejected": {}},
        },
    }
    lines = lines_of(summary, Path("out"))
    assert "300 x real time" in lines[0]
    assert lines[1] == "no estimate: aligning, no heading source"
    assert "3 fused, rejected: 2 gate, NIS 0.5" in lines[2]
    assert lines[3].endswith("0 fused, rejected: none")
    assert lines[-1] == "written to out"
