"""EuRoC folders: nanoseconds, forward-left-up and east-north-up become ours."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mavins.config import load
from mavins.errors import LogFormatError
from mavins.logs.content import kind_of
from mavins.logs.euroc import read_euroc
from mavins.logs.sensor_log import Choice
from mavins.nav.so3 import quat_to_euler
from mavins.sources import source_of

START_NS = 1_403_636_579_763_555_584
IMU_HEAD = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
TRUTH_HEAD = (
    "#timestamp, p_RS_R_x [m], ..., q_RS_w [], ..., v_RS_R_x [m s^-1], ..., b_a_RS_S_z [m s^-2]"
)


def folder(path: Path, gps: bool = True, sensors: int = 1) -> Path:
    """A vehicle that faces west, with its nose 0.1 rad up, and climbs to the north-east."""
    for i in range(sensors):
        rows = [f"{START_NS + k * 5_000_000},{0.1 + i},0.2,0.3,0.5,1.0,9.8" for k in range(200)]
        write(path, f"imu{i}", IMU_HEAD, rows)
    # R_SB: yaw of 180 deg about up (east to west), then the nose up: a turn of -0.1 about left
    q = (0.0, math.sin(0.05), 0.0, math.cos(0.05))
    truth = [
        f"{START_NS + k * 5_000_000},1,2,3,{q[0]},{q[1]},{q[2]},{q[3]},0.5,0.25,1,0,0,0,0,0,0"
        for k in range(200)
    ]
    write(path, "state_groundtruth_estimate0", TRUTH_HEAD, truth)
    if gps:
        fixes = [f"{START_NS + k * 200_000_000},47.0,8.0,500.0,1,2,3" for k in range(5)]
        write(path, "gps0", "#timestamp [ns],lat [deg],lon [deg],alt [m],v_n,v_e,v_d", fixes)
    return path


def write(path: Path, sensor: str, head: str, rows: list[str]) -> None:
    place = path / "mav0" / sensor
    place.mkdir(parents=True)
    (place / "data.csv").write_text("\n".join([head, *rows]) + "\n")


def test_axes_and_stamps(tmp_path: Path) -> None:
    log = read_euroc(folder(tmp_path))
    assert kind_of(tmp_path) == kind_of(tmp_path / "mav0") == "euroc"
    assert log.imu.t_us[0] == pytest.approx(START_NS * 1e-3, abs=0.6)
    assert (np.diff(log.imu.t_us) == 5000).all()
    np.testing.assert_allclose(log.imu.gyro_b[0], [0.1, -0.2, -0.3])
    np.testing.assert_allclose(log.imu.accel_b[0], [0.5, -1.0, -9.8])
    assert log.truth is not None
    np.testing.assert_allclose(log.truth.v_l[0], [0.25, 0.5, -1.0])
    roll, pitch, yaw = (float(angle) for angle in quat_to_euler(log.truth.q_lb[0]))
    assert (roll, pitch, yaw) == pytest.approx((0.0, 0.1, -math.pi / 2), abs=1e-9)
    assert np.isnan(log.truth.lla).all()
    assert log.gnss[0].v_l == (1.0, 2.0, 3.0)
    assert math.degrees(log.gnss[0].lat) == pytest.approx(47.0)


def test_other_sensors(tmp_path: Path) -> None:
    log = read_euroc(folder(tmp_path, sensors=2), Choice(imu="1"))
    assert log.imu.gyro_b[0, 0] == pytest.approx(1.1)
    assert log.choices["imu"] == ["imu0", "imu1"]
    with pytest.raises(LogFormatError, match="no IMU called '2'; it has imu0, imu1"):
        read_euroc(tmp_path, Choice(imu="2"))


def test_without_gnss_there_is_nothing_to_estimate(tmp_path: Path) -> None:
    assert not read_euroc(folder(tmp_path, gps=False)).gnss
    with pytest.raises(LogFormatError, match="no GNSS fixes"):
        source_of(tmp_path, load())


def test_damage_is_counted(tmp_path: Path) -> None:
    path = folder(tmp_path) / "mav0" / "imu0" / "data.csv"
    lines = path.read_text().splitlines()
    lines[50] = lines[50][:30]
    lines[60], lines[61] = lines[61], lines[60]
    lines[70] = lines[69]
    path.write_text("\n".join(lines))
    log = read_euroc(tmp_path)
    assert log.damage == {"bad_lines": 1, "imu_backwards": 1}
    assert log.dropped["imu repeated"] == 1
    assert len(log.imu) == 198


def test_too_few_columns(tmp_path: Path) -> None:
    write(tmp_path, "imu0", "#t,wx,wy", ["1,2,3", "4,5,6"])
    with pytest.raises(LogFormatError, match="3 columns: too few"):
        read_euroc(tmp_path)
