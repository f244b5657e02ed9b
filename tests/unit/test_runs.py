"""A log in Python: what a run gives is what replay writes, and nothing is imported before it is asked for."""

from __future__ import annotations

import csv
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mavins
from mavins.errors import LogFormatError
from mavins.nav.so3 import quat_to_euler
from mavins.replay import ReplayOptions, replay

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

SECONDS = 8
SETTINGS = {"states": {"lever_arm": "estimate"}}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vehicle that stands with its nose to the east."""
    rng = np.random.default_rng(5)
    t = np.arange(0, SECONDS * 1_000_000, 20_000)
    f = rng.normal(size=(len(t), 3)) * 0.02 - [0.0, 0.0, 9.8065]
    w = rng.normal(size=(len(t), 3)) * 1e-3
    place = "45.0,-93.0,250.0,0,0,0"
    tables = {
        "imu": [
            "t_us,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z",
            *(",".join(map(str, (k, *a, *b))) for k, a, b in zip(t, f, w, strict=True)),
        ],
        "gnss": [
            "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d,fix_type,satellites",
            *(f"{k},{place},3,9" for k in t[::10]),
        ],
        "heading": ["t_us,yaw", *(f"{k},{math.pi / 2}" for k in t[::10])],
        "reference": [
            "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d,roll,pitch,yaw",
            *(f"{k},{place},0,0,{math.pi / 2}" for k in t[::5]),
        ],
    }
    folder = tmp_path_factory.mktemp("flight")
    for name, lines in tables.items():
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def result(log: Path) -> mavins.Result:
    return mavins.run(log, mavins.load_config(None, SETTINGS), smooth=True)


def test_the_arrays_are_those_of_the_files(
    log: Path, result: mavins.Result, tmp_path: Path
) -> None:
    config = mavins.load_config(None, SETTINGS)
    summary = replay(log, tmp_path, config, ReplayOptions(smooth=True))
    assert result.smoothed is not None
    for name, run in (("estimates", result), ("smoothed", result.smoothed)):
        with (tmp_path / "eskf" / f"{name}.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert run.t_us.tolist() == [int(row["t_us"]) for row in rows]
        for columns, values in (
            (("lat_deg", "lon_deg"), np.degrees(run.lla[:, :2])),
            (("p_n", "p_e", "p_d"), run.p_n),
            (("v_n", "v_e", "v_d"), run.v),
            (("roll", "pitch", "yaw"), run.euler),
            (("q_w", "q_x", "q_y", "q_z"), run.quaternions),
            (("sd_p_n", "sd_p_e", "sd_p_d"), run.sd_p_n),
            (("sd_v_n", "sd_v_e", "sd_v_d"), run.sd_v),
            (("sd_roll", "sd_pitch", "sd_yaw"), run.sd_euler),
            (("b_g_x", "b_g_y", "b_g_z"), run.b_g),
            (("b_a_x", "b_a_y", "b_a_z"), run.b_a),
            (("l_b_x", "l_b_y", "l_b_z"), run.state("l_b")[0]),
            (("sd_l_b_x", "sd_l_b_y", "sd_l_b_z"), run.state("l_b")[1]),
        ):
            written = np.array([[float(row[c]) for c in columns] for row in rows])
            np.testing.assert_allclose(values, written, rtol=0, atol=6e-7)
    timing = ("wall_s", "cpu_s", "times_real_time")
    assert result.summary == {k: v for k, v in summary.items() if k not in timing}


def test_innovations_by_aiding(log: Path, result: mavins.Result, tmp_path: Path) -> None:
    replay(log, tmp_path, mavins.load_config(None, SETTINGS), ReplayOptions())
    with (tmp_path / "eskf" / "innovations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["aiding"] for row in rows} == set(result.innovations)
    for name, seen in result.innovations.items():
        mine = [row for row in rows if row["aiding"] == name]
        assert seen.t_us.tolist() == [int(row["t_us"]) for row in mine]
        assert seen.accepted.tolist() == [row["accepted"] == "1" for row in mine]
        assert seen.reason.tolist() == [row["reason"] for row in mine]
        written = [float(row["nis"] or "nan") for row in mine]
        np.testing.assert_allclose(seen.nis, written, rtol=1e-8)
        for k in range(seen.rows):
            written = [float(row[f"innovation_{k}"] or "nan") for row in mine]
            np.testing.assert_allclose(seen.innovation[:, k], written, rtol=1e-8)


def test_errors_and_attitude(result: mavins.Result) -> None:
    assert result.truth is None
    assert result.reference is not None
    assert result.errors is not None
    assert abs(result.errors.pos).max() < 1.0
    turned = np.array([quat_to_euler(q) for q in result.quaternions])
    np.testing.assert_allclose(turned, result.euler, atol=1e-9)
    assert result.config.gnss.delay == 0.0


def test_bounds(log: Path, result: mavins.Result) -> None:
    part = mavins.run(mavins.open_log(log), start=4.0, end=6.0, rate=0)
    assert part.t_us[0] == 4_000_000
    assert part.t_us[-1] == 6_000_000
    assert len(part) == 101
    assert part.summary["rows"] == 101
    stamps = np.concatenate([seen.t_us for seen in part.innovations.values()])
    assert stamps.min() >= 4_000_000
    assert stamps.max() <= 6_000_000
    assert part.smoothed is None
    with pytest.raises(KeyError):
        part.state("b_m")


def test_nothing_at_all_within_the_bounds(log: Path) -> None:
    nothing = mavins.run(log, start=100.0)
    assert len(nothing) == 0
    assert nothing.errors is None
    assert nothing.innovations == {}
    assert nothing.p_n.shape == (0, 3)


def test_a_log_can_be_run_again(log: Path, result: mavins.Result) -> None:
    opened = mavins.open_log(log)
    assert opened.kind == "csv_folder"
    first = mavins.run(opened)
    other = mavins.run(opened, mavins.load_config(None, {"filter": "iekf"}))
    again = mavins.run(opened)
    assert first.table.tobytes() == again.table.tobytes()
    assert other.summary["filter"] == "iekf"
    assert other.table.tobytes() != first.table.tobytes()


def test_what_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("nothing of use")
    with pytest.raises(LogFormatError):
        mavins.run(tmp_path / "a")


def test_a_figure(result: mavins.Result) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    figure = result.plot()
    panels = {panel.get_title(): panel for panel in figure.axes}
    assert len(panels["track"].lines) == 2
    assert len(panels["position error, +-3 sigma"].lines) == 9
    assert len(panels["NIS per row"].lines) == len(result.innovations)


def test_importing_the_package_is_light() -> None:
    code = "import sys, mavins; print('numpy' in sys.modules, 'yaml' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
    assert set(mavins.__all__) == set(dir(mavins))
    assert all(getattr(mavins, name) is not None for name in mavins.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        mavins.nonsense  # noqa: B018
