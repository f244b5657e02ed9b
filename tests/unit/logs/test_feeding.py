"""A folder of CSV files through the estimator: in the order of stamps, and judged by what its reference has."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.replay import lines_of
from mavins.config import Config, load
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Between, by_turns
from mavins.logs.csv_folder import read_csv_folder
from mavins.logs.feeding import feed_log, settled
from mavins.replay import ReplayOptions, replay
from mavins.types import ImuTable

SECONDS = 8


def standing(path: Path, seconds: int = SECONDS) -> Path:
    """A vehicle that stands with its nose to the east; its reference knows attitude and, at times, position."""
    rng = np.random.default_rng(5)
    t = np.arange(0, seconds * 1_000_000, 20_000)
    imu = [
        f"{k},{f[0]:.5f},{f[1]:.5f},{f[2] - 9.8065:.5f},{w[0]:.6f},{w[1]:.6f},{w[2]:.6f}"
        for k, f, w in zip(
            t, rng.normal(size=(len(t), 3)) * 0.02, rng.normal(size=(len(t), 3)) * 1e-3, strict=True
        )
    ]
    tables = {
        "imu": ["t_us,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z", *imu],
        "gnss": [
            "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d,fix_type,satellites",
            *(f"{k},45.0,-93.0,250.0,0,0,0,3,9" for k in t[::10]),
        ],
        "heading": ["t_us,yaw", *(f"{k},{math.pi / 2}" for k in t[::10])],
        "reference": [
            "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d,roll,pitch,yaw",
            *(
                f"{k},45.0,-93.0,250.0,,,,0,0,{math.pi / 2}"
                if n % 7
                else f"{k},,,,,,,0,0,{math.pi / 2}"
                for n, k in enumerate(t[::5])
            ),
        ],
    }
    path.mkdir(exist_ok=True)
    for name, lines in tables.items():
        (path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.jit
def test_replay_of_a_folder(tmp_path: Path) -> None:
    log = standing(tmp_path / "flight")
    seen: list[float] = []
    summary = replay(log, tmp_path / "out", load(), ReplayOptions(), seen.append)
    assert summary["health"] == "running"
    assert summary["messages"] == {
        "imu.csv": SECONDS * 50,
        "gnss.csv": SECONDS * 5,
        "heading.csv": SECONDS * 5,
    }
    assert summary["log_s"] == pytest.approx(SECONDS - 0.02)
    truth = summary["reference"]
    assert truth["source"] == "reference.csv"
    assert set(truth["rms"]) == {"pos_m", "att_deg"}
    assert max(truth["rms"]["pos_m"]) < 0.5
    assert max(truth["max"]["att_deg"]) < 1.0
    assert (tmp_path / "out/eskf/estimates.csv").stat().st_size > 10_000
    assert seen[-1] == 1.0
    text = "\n".join(lines_of(summary, tmp_path))
    assert "difference to reference.csv" in text
    assert "velocity N/E/D" not in text


class Recorder(Estimator):
    """Notes what comes in."""

    def __init__(self) -> None:
        super().__init__(Config())
        self.log: list[tuple[str, int]] = []

    def feed_imu(self, table: object) -> None:
        self.log += [("imu", int(t)) for t in table.t_us]  # type: ignore[attr-defined]

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        by_turns(self, table, between)

    def feed_gnss(self, fix: object) -> None:
        self.log.append(("gnss", fix.t_us))  # type: ignore[attr-defined]
        assert fix.delay == 0.25  # type: ignore[attr-defined]

    def feed_heading(self, fix: object) -> None:
        self.log.append(("heading", fix.t_us))  # type: ignore[attr-defined]


def test_readings_come_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    folder = read_csv_folder(standing(tmp_path, 2))
    recorder = Recorder()
    feed_log(folder, recorder, load(None, {"gnss.delay": 0.25}), lambda _: None)
    stamps = [t for _, t in recorder.log]
    assert stamps == sorted(stamps)
    assert recorder.log[:3] == [("imu", 0), ("gnss", 0), ("heading", 0)]
    assert len(stamps) == 100 + 10 + 10


@pytest.mark.jit
def test_a_magnetometer_aligns_a_folder_without_headings_and_a_barometer_holds_the_height(
    tmp_path: Path,
) -> None:
    log = standing(tmp_path / "flight")
    (log / "heading.csv").unlink()
    field_l = [0.5, 0.0, math.sqrt(0.75)]
    field_b = [field_l[1], -field_l[0], field_l[2]]  # the nose points to the east
    stamps = range(0, SECONDS * 1_000_000, 20_000)
    mag = [f"{t},{','.join(str(600.0 * value) for value in field_b)}" for t in stamps]
    (log / "mag.csv").write_text("\n".join(["t_us,mag_x,mag_y,mag_z", *mag]) + "\n")
    baro = [f"{t},{8.0 + 0.1 * (k % 2)}" for k, t in enumerate(stamps)]
    (log / "baro.csv").write_text("\n".join(["t_us,alt_m", *baro]) + "\n")
    config = load(None, {"magnetometer": {"declination_deg": 0.0, "inclination_deg": 60.0}})
    summary = replay(log, tmp_path / "out", config, ReplayOptions())
    assert summary["health"] == "running"
    assert max(summary["reference"]["max"]["att_deg"]) < 1.0
    for name in ("magnetometer", "baro"):
        aiding = summary["aiding"][name]
        assert aiding["accepted"] > 5
        assert aiding["rejected"] == {}
    effective = load(tmp_path / "out/eskf/config.yaml").magnetometer
    assert effective.enabled is True
    assert effective.hard_iron != "auto"


def test_settings_are_settled_by_what_the_folder_holds(tmp_path: Path) -> None:
    folder = read_csv_folder(standing(tmp_path, 2))
    config = settled(load(), folder)
    assert config.gnss.delay == 0.0
    assert config.magnetometer.enabled is False  # there are headings, and no magnetometer
    assert settled(load(None, {"gnss.delay": 0.2}), folder).gnss.delay == 0.2


def test_the_delay_that_the_log_tells_is_used_unless_one_is_set(tmp_path: Path) -> None:
    log = dataclasses.replace(read_csv_folder(standing(tmp_path / "flight")), gnss_delay=0.11)
    assert settled(load(), log).gnss.delay == 0.11
    assert settled(load(None, {"gnss.delay": 0.05}), log).gnss.delay == 0.05
    assert settled(load(), dataclasses.replace(log, gnss_delay=None)).gnss.delay == 0.0
