"""`mavins tune` and `mavins allan` as a user runs them, on simulated logs."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.config import Config, load
from mavins.evaluation.replays import cores
from mavins.evaluation.tunable import put, tuned
from mavins.evaluation.tuning import tune
from mavins.examples.scenarios import flight, matched
from sitl.heading import HeadingSettings
from sitl.imu import ImuSettings, TriadSettings
from sitl.scenario import Scenario
from sitl.scenario import load as scenario_of

TRUE = {
    "imu.gyro_noise": 1e-3,
    "imu.accel_noise": 3e-2,
    "gnss.position_sigma": 0.5,
    "gnss.altitude_sigma": 0.8,
    "gnss.velocity_sigma": 0.1,
    "heading.sigma_deg": 2.0,
}
FACTORS = (0.2, 5.0, 5.0, 0.2, 0.3, 4.0)


def scenario() -> Scenario:
    """An IMU so noisy that it shows within two flights of two minutes."""
    mission = scenario_of("quad_mission")
    gyro = TriadSettings(noise=TRUE["imu.gyro_noise"], bias=0.005, bias_walk=1e-5)
    accel = TriadSettings(noise=TRUE["imu.accel_noise"], bias=0.05, bias_walk=1e-4)
    return dataclasses.replace(
        mission,
        imu=ImuSettings(rate=100, gyro=gyro, accel=accel),
        gnss=dataclasses.replace(mission.gnss, latency=0.12),
        heading=HeadingSettings(rate=5, sigma_deg=2.0),
    )


@pytest.mark.slow
@pytest.mark.jit
def test_wrong_noises_and_delay_are_found() -> None:
    wrong = {path: f * TRUE[path] for path, f in zip(TRUE, FACTORS, strict=True)}
    config = put(tuned(matched(Config(), scenario()), wrong), {"gnss.delay": 0.0})
    tapes = [flight(config, scenario(), seed, 120.0)[0].delayed(0.0) for seed in (1, 2)]
    result = tune(tapes, "eskf", False, cores())
    assert result.accepted
    assert result.thinning == (1, 1)
    found = {f.parameter.path: f for f in result.found}
    assert found["gnss.delay"].after == pytest.approx(0.12, abs=0.01)
    for path, true in TRUE.items():
        low, high = found[path].interval
        width = math.log(high / low) / 3.92
        assert abs(math.log(found[path].after / true)) < max(math.log(1.25), 3.0 * width), path
    for path in ("gnss.position_sigma", "gnss.velocity_sigma", "heading.sigma_deg"):
        assert found[path].after == pytest.approx(TRUE[path], rel=0.25)


def standing_folder(folder: Path, seconds: float) -> Path:
    """imu.csv of an IMU at rest, 50 samples a second, and nothing else."""
    rng = np.random.default_rng(4)
    n = round(50 * seconds)
    gyro = 3e-4 * math.sqrt(50) * rng.standard_normal((n, 3))
    accel = 2e-3 * math.sqrt(50) * rng.standard_normal((n, 3)) + [0.0, 0.0, -9.81]
    folder.mkdir()
    with (folder / "imu.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t_us", "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"])
        stamps = (np.arange(n) * 20_000).tolist()
        writer.writerows(
            [t, *a, *g] for t, a, g in zip(stamps, accel.tolist(), gyro.tolist(), strict=True)
        )
    return folder


def test_allan_writes_a_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = standing_folder(tmp_path / "log", 300.0)
    assert main(["allan", str(log), "--out", str(tmp_path / "allan.yaml")]) == 0
    config = load(tmp_path / "allan.yaml")
    assert config.imu.gyro_noise == pytest.approx(3e-4, rel=0.05)
    assert config.imu.accel_noise == pytest.approx(2e-3, rel=0.05)
    assert config.imu.gyro_bias_walk == Config().imu.gyro_bias_walk
    shown = capsys.readouterr().out
    assert "standing for 300 s" in shown
    assert "too short for a random walk" in shown


def test_allan_needs_a_standing_spell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["allan", str(standing_folder(tmp_path / "log", 10.0))]) == 2
    assert "stands still for 10 s at most" in capsys.readouterr().err


def test_a_log_without_fixes_cannot_be_tuned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tune", str(standing_folder(tmp_path / "log", 10.0)), "--jobs", "1"]) == 2
    assert "no GNSS fixes" in capsys.readouterr().err
