"""Both recordings through `mavins replay`: the figures that were promised, and what the result folder holds."""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins import __version__
from mavins.cli.main import main
from mavins.config import Config, load

pytestmark = [pytest.mark.slow, pytest.mark.jit]

PX4 = "recordings/px4_quad_mission.tlog.xz"
ARDUPILOT = "recordings/ap_copter_square_circle.tlog.xz"

HEADER = (
    "t_us,lat_deg,lon_deg,alt_m,p_n,p_e,p_d,v_n,v_e,v_d,roll,pitch,yaw,q_w,q_x,q_y,q_z,"
    "sd_p_n,sd_p_e,sd_p_d,sd_v_n,sd_v_e,sd_v_d,sd_roll,sd_pitch,sd_yaw,"
    "b_g_x,b_g_y,b_g_z,b_a_x,b_a_y,b_a_z,tau,sd_tau"
)


@dataclass(frozen=True)
class Result:
    """What a replay printed and wrote."""

    printed: str
    out: Path

    @property
    def folder(self) -> Path:
        return self.out / "eskf"

    @property
    def summary(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads((self.out / "summary.json").read_text())
        return content

    def rows(self) -> tuple[list[str], np.ndarray[Any, np.dtype[np.float64]]]:
        with (self.folder / "estimates.csv").open() as file:
            reader = csv.reader(file)
            header = next(reader)
            return header, np.array([[float(v) for v in row] for row in reader])


def replayed(
    capsys_disabled: pytest.CaptureFixture[str] | None, log: Path, out: Path, *options: str
) -> Result:
    assert main(["replay", str(log), "--out", str(out), *options]) == 0
    return Result("" if capsys_disabled is None else capsys_disabled.readouterr().out, out)


@pytest.fixture(scope="module")
def px4(shared: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Result:
    out = tmp_path_factory.mktemp("px4")
    return replayed(None, shared(PX4), out, "--start", "60", "--end", "248")


def settings_file(folder: Path, text: str) -> str:
    path = folder / "settings.yaml"
    path.write_text(text)
    return str(path)


def within(summary: dict[str, Any], name: str, limits: tuple[float, float, float]) -> None:
    reached = summary["truth"]["rms"][name]
    for axis, (value, limit) in enumerate(zip(reached, limits, strict=True)):
        assert value <= limit, f"{name}[{axis}]: {reached} against {limits}"


@pytest.mark.wheel
def test_px4_is_at_least_as_good_as_the_autopilots_own_filter(px4: Result) -> None:
    summary = px4.summary
    assert summary["truth"]["source"] == "HIL_STATE_QUATERNION"
    assert summary["truth"]["instants"] > 9300
    within(summary, "pos_m", (0.041, 0.029, 0.049))
    within(summary, "vel_m_s", (0.023, 0.030, 0.016))
    within(summary, "att_deg", (0.12, 0.10, 0.30))


@pytest.mark.parametrize("delay", ["0.18", "auto"])
def test_ardupilot_is_better_than_the_autopilots_own_filter(
    delay: str, shared: Callable[[str], Path], tmp_path: Path
) -> None:
    config = settings_file(tmp_path, f"gnss:\n  delay: {delay}\n")
    options = ("--start", "70", "--end", "248", "--config", config)
    summary = replayed(None, shared(ARDUPILOT), tmp_path / "out", *options).summary
    assert summary["truth"]["source"] == "SIM_STATE"
    within(summary, "pos_m", (0.43, 0.34, 0.08))
    within(summary, "vel_m_s", (0.13, 0.13, 0.03))
    if delay != "auto":
        within(summary, "att_deg", (0.6, 0.6, 3.2))
    assert summary["resets"] == summary["realignments"] == 0


def test_summary_says_what_was_seen_used_and_rejected(px4: Result) -> None:
    summary = px4.summary
    assert summary["mavins"] == __version__
    assert summary["filter"] == "eskf"
    assert summary["sysid"] == 8
    assert summary["imu"] == {"message": "HIGHRES_IMU", "id": 0}
    assert summary["messages"]["HIGHRES_IMU"] == summary["imu_samples"] > 50_000
    assert summary["dropped"] == {"GPS_RAW_INT before HEARTBEAT": 7}
    assert summary["health"] == "running"
    assert summary["resets"] == summary["realignments"] == 0
    assert summary["wall_s"] > 0.0
    assert summary["cpu_s"] > 0.0
    assert summary["times_real_time"] == pytest.approx(summary["log_s"] / summary["cpu_s"])
    assert summary["log_s"] == pytest.approx(240.07, abs=0.1)


def test_summary_judges_the_noise_that_was_assumed(px4: Result) -> None:
    aiding = px4.summary["aiding"]
    assert set(aiding) == {
        "gnss_position",
        "gnss_velocity",
        "heading",
        "zero_velocity",
        "zero_rate",
    }
    for name, one in aiding.items():
        assert one["accepted"] > 100, name
        assert isinstance(one["rejected"], dict), name
        assert one["nis_per_row"] > 0.0, name
        sizes = {len(one[key]) for key in ("innovation_rms", "expected_rms", "assumed_noise")}
        assert len(sizes) == 1, name
    assert len(aiding["gnss_velocity"]["innovation_rms"]) == 2  # GPS_RAW_INT has no vertical one
    position = aiding["gnss_position"]
    # the receiver reports .9 m where its error is .025 m: that is to be seen
    assert position["assumed_noise"][0] == pytest.approx(0.9, rel=1e-3)
    assert position["innovation_rms"][0] < 0.1
    assert position["nis_per_row"] < 0.1


def test_rejections_are_counted_with_their_reasons(
    shared: Callable[[str], Path], tmp_path: Path
) -> None:
    # nothing is as accurate as this, so every fix in flight meets the quality gate or the innovation gate
    config = settings_file(tmp_path, "gnss:\n  max_sigma_speed: 0.0211\n  gate: 0.02\n")
    summary = replayed(None, shared(ARDUPILOT), tmp_path / "out", "--config", config).summary
    rejected = summary["aiding"]["gnss_position"]["rejected"]
    assert rejected
    assert all(isinstance(n, int) and n > 0 for n in rejected.values())
    total = sum(rejected.values()) + summary["aiding"]["gnss_position"]["accepted"]
    with (tmp_path / "out/eskf/innovations.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["aiding"] == "gnss_position"]
    assert len(rows) == total
    reasons = [row["reason"] for row in rows if row["accepted"] == "0"]
    assert {reason: reasons.count(reason) for reason in set(reasons)} == rejected


@pytest.mark.wheel
def test_estimates_have_the_documented_columns_and_rate(px4: Result) -> None:
    header, rows = px4.rows()
    assert ",".join(header) == HEADER
    assert len(rows) == px4.summary["rows"]
    t_us = rows[:, 0]
    assert 60e6 <= t_us[0] < 60.02e6
    assert 247.9e6 < t_us[-1] <= 248e6
    assert len(rows) == 188 * 50 + 1
    assert (np.diff(t_us) > 0).all()
    # at each grid point the first IMU sample at or after it
    assert (t_us % 20_000 < 20_000).all()
    assert len(set(t_us.astype(np.int64) // 20_000)) == len(rows)
    assert np.isfinite(rows).all()
    columns = {name: rows[:, i] for i, name in enumerate(header)}
    quaternions = np.column_stack([columns[f"q_{axis}"] for axis in "wxyz"])
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(1.0, abs=1e-7)
    assert columns["lat_deg"] == pytest.approx(47.3977, abs=0.002)
    assert columns["lon_deg"] == pytest.approx(8.5456, abs=0.002)
    assert columns["alt_m"].min() > 480.0
    assert abs(columns["yaw"]).max() <= math.pi
    for name in header:
        if name.startswith("sd_"):
            assert (columns[name] > 0.0).all(), name


def test_latitude_and_longitude_have_ten_decimals(px4: Result) -> None:
    with (px4.folder / "estimates.csv").open() as file:
        for line in itertools.islice(file, 1, 50):
            lat, lon = line.split(",")[1:3]
            assert len(lat.partition(".")[2]) == len(lon.partition(".")[2]) == 10


def test_config_is_the_effective_one_and_loads_back(
    shared: Callable[[str], Path], tmp_path: Path, px4: Result
) -> None:
    assert load(px4.folder / "config.yaml") == Config()
    first_line = (px4.folder / "config.yaml").read_text().splitlines()[0]
    assert __version__ in first_line
    config = settings_file(tmp_path, "gnss:\n  delay: 0.18\n")
    options = ("--config", config, "--start", "100", "--end", "101")
    result = replayed(None, shared(ARDUPILOT), tmp_path / "out", *options)
    assert load(result.folder / "config.yaml") == load(config)
    assert load(result.folder / "config.yaml").gnss.delay == 0.18


def test_start_end_and_rate_bound_what_is_written_and_judged(
    shared: Callable[[str], Path],
    tmp_path: Path,
    px4: Result,
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = ("--start", "100", "--end", "110", "--rate", "0")
    result = replayed(capsys, shared(PX4), tmp_path / "all", *options)
    _, every = result.rows()
    assert every[0, 0] >= 100e6
    assert every[-1, 0] <= 110e6
    # 250 Hz less the samples that went missing
    assert 2200 < len(every) <= 2501
    assert result.summary["truth"]["instants"] == len(every)
    assert f"{len(every)} rows" in result.printed
    # the whole log is filtered whatever is written: the same instants, the same bytes
    _, judged = px4.rows()
    shared_rows = judged[(judged[:, 0] >= 100e6) & (judged[:, 0] <= 110e6)]
    at = {row[0]: row for row in every}
    assert len(shared_rows) == 501
    assert all((at[row[0]] == row).all() for row in shared_rows)
    _, five = replayed(
        None, shared(PX4), tmp_path / "five", "--start", "100", "--end", "110", "--rate", "5"
    ).rows()
    assert len(five) == 51


def test_a_replay_gives_the_same_bytes_again(
    shared: Callable[[str], Path], tmp_path: Path, px4: Result
) -> None:
    again = replayed(None, shared(PX4), tmp_path, "--start", "60", "--end", "248")
    for name in ("estimates.csv", "innovations.csv", "config.yaml"):
        assert (again.folder / name).read_bytes() == (px4.folder / name).read_bytes(), name
