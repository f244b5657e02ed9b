"""KF-GINS text: increments become rates at the middle of their intervals, whichever file is which."""

from __future__ import annotations

import dataclasses
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from mavins.config import load
from mavins.errors import LogFormatError
from mavins.logs.content import kind_of
from mavins.logs.kf_gins import read_kf_gins, role_of
from mavins.logs.sensor_log import Choice
from mavins.replay import ReplayOptions, replay
from sitl.scenario import load as load_scenario
from sitl.simulation import simulate

RATE = 100
WEEK_S = 604_800.0


def simulated(folder: Path, seconds: float, start: float = 456_300.0) -> Path:
    """A flight of our simulator, as the published data are written: IMU, GNSS and truth."""
    scenario = load_scenario("quad_mission")
    imu = dataclasses.replace(scenario.imu, rate=RATE, integrate=True)
    flight = simulate(dataclasses.replace(scenario, imu=imu), 1, seconds)
    begin = flight.imu.t_us[0] * 1e-6
    dt = 1.0 / RATE

    def second(t_us: int) -> str:
        return f"{(t_us * 1e-6 - begin + start) % WEEK_S:.6f}"

    def row(*values: float) -> str:
        return " ".join(f"{value:.12g}" for value in values)

    imu_lines = [
        f"{second(t)} {row(*(gyro * dt), *(accel * dt))}"
        for t, gyro, accel in zip(
            flight.imu.t_us.tolist(), flight.imu.gyro_b, flight.imu.accel_b, strict=True
        )
    ]
    gnss_lines = [
        f"{second(f.t_us)} {row(math.degrees(f.lat), math.degrees(f.lon), f.alt, 0.8, 0.8, 1.5, *f.v_l, 0.1, 0.1, 0.1)}"
        for f in flight.fixes
        if f.v_l is not None
    ]
    truth_lines = []
    for state in flight.states:
        s = state.sample
        w, x, y, z = s.q_lb
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(2 * (w * y - z * x))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        place = (math.degrees(s.lat), math.degrees(s.lon), s.alt)
        angles = np.degrees([roll, pitch, yaw])
        truth_lines.append(f"2017 {second(s.t_us)} {row(*place, *s.v_l, *angles)}")
    folder.mkdir(parents=True)
    (folder / "Sensor-A.txt").write_text("\n".join(imu_lines) + "\n")
    (folder / "Fixes.txt").write_text("\n".join(gnss_lines) + "\n")
    (folder / "truth.nav").write_text("\n".join(truth_lines) + "\n")
    (folder / "README").write_text("a flight\n")
    (folder / "settings.yaml").write_text("initpos: [ 30.4, 114.4, 20.9 ]\n")
    return folder


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("kf") / "flight", 90.0)


def test_which_file_is_which(flight: Path) -> None:
    roles = {path.name: role_of(path) for path in flight.iterdir()}
    assert roles == {
        "Sensor-A.txt": "imu",
        "Fixes.txt": "gnss",
        "truth.nav": "truth",
        "README": None,
        "settings.yaml": None,
    }
    assert kind_of(flight) == "kf_gins"
    assert kind_of(flight / "Sensor-A.txt") == "kf_gins"


def test_increments_become_rates_at_the_middle(flight: Path) -> None:
    log = read_kf_gins(flight)
    assert log.imu.t_us[0] == 456_300_000_000 - 5_000
    assert np.median(np.diff(log.imu.t_us)) == 10_000
    assert np.median(log.imu.accel_b[:200, 2]) == pytest.approx(-9.8, abs=0.1)
    assert log.names == {"imu": "Sensor-A.txt", "gnss": "Fixes.txt", "truth": "truth.nav"}
    assert log.gnss[0].sigma_h == pytest.approx(0.8)
    assert log.gnss[0].sigma_v == pytest.approx(1.5)
    assert log.gnss[0].sigma_speed == pytest.approx(0.1)
    assert log.gnss[0].v_l is not None
    assert log.truth is not None
    assert log.reference is None
    assert not log.damage
    one = read_kf_gins(flight / "Sensor-A.txt", Choice(gnss="Fixes.txt"))
    np.testing.assert_array_equal(one.imu.t_us, log.imu.t_us)


@pytest.mark.jit
def test_a_replay_finds_position_and_attitude(flight: Path, tmp_path: Path) -> None:
    summary = replay(flight, tmp_path / "out", load(), ReplayOptions(456_360.0))
    rms = summary["truth"]["rms"]
    assert max(rms["pos_m"]) < 1.5
    assert max(rms["vel_m_s"]) < 0.3
    assert max(rms["att_deg"][:2]) < 1.0
    assert rms["att_deg"][2] < 5.0  # from motion: there is no heading in these files


def test_a_week_ends(tmp_path: Path) -> None:
    log = read_kf_gins(simulated(tmp_path / "flight", 4.0, WEEK_S - 2.0))
    assert (np.diff(log.imu.t_us) == 10_000).all()
    assert log.gnss[-1].t_us > WEEK_S * 1e6


def test_damaged_lines_and_a_cut_are_counted(flight: Path, tmp_path: Path) -> None:
    lines = (flight / "Sensor-A.txt").read_text().splitlines()[:1000]
    lines[300] = lines[300].replace(".", "?")
    lines[400] = lines[400][:40]
    (tmp_path / "imu.txt").write_text("\n".join(lines)[:-30])
    log = read_kf_gins(tmp_path / "imu.txt")
    assert log.damage["bad_lines"] == 3
    assert len(log.imu) == 997
    assert not log.gnss
    packed = gzip.compress("\n".join(lines).encode())
    (tmp_path / "imu.txt").write_bytes(packed[: len(packed) * 3 // 4])
    assert 500 < len(read_kf_gins(tmp_path / "imu.txt").imu) < 900


def test_no_imu_is_one_line(flight: Path, tmp_path: Path) -> None:
    (tmp_path / "gnss.txt").write_text((flight / "Fixes.txt").read_text())
    with pytest.raises(LogFormatError, match="holds no IMU increments"):
        read_kf_gins(tmp_path / "gnss.txt")
    with pytest.raises(LogFormatError, match="is no log"):
        kind_of(tmp_path)
