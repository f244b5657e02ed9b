"""Folders of CSV files: what is read of them, and how damage is named."""

from __future__ import annotations

import gzip
import lzma
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.errors import LogFormatError
from mavins.logs.csv_folder import read_csv_folder
from mavins.logs.csv_table import read_table
from mavins.nav.so3 import quat_to_euler

IMU = "t_us,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z\n"
ROWS = "0,0,0,0,0,0,0\n20000,0.1,0.2,-9.8,0.01,0.02,0.03\n40000,0.1,0.2,-9.7,0.01,0.02,0.04\n"
GNSS = "t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d,fix_type,satellites\n"


def folder_of(path: Path, **tables: str) -> Path:
    for name, text in {"imu": IMU + ROWS, **tables}.items():
        (path / f"{name}.csv").write_text(text)
    return path


def test_all_tables(tmp_path: Path) -> None:
    folder_of(
        tmp_path,
        gnss=GNSS
        + "10000,45,-93,250,1,2,-3,3,9\n20000,45,-93,250,1,2,,4,0\n30000,,-93,250,,,,3,9\n",
        mag="t_us,mag_x,mag_y,mag_z\n0,0,0,0\n20000,268,-9,-552\n",
        baro="t_us,alt_m\n0,237.2\n",
        heading="t_us,yaw,sigma\n0,1.5,\n20000,1.6,0.02\n",
        reference="t_us,lat_deg,lon_deg,alt_m,vel_n,vel_e,vel_d,roll,pitch,yaw\n"
        "0,,,,,,,0.1,-0.2,3.1\n50000,45,-93,250,1,2,3,0.1,-0.2,-3.1\n",
    )
    log = read_csv_folder(tmp_path)
    assert log.imu.t_us.tolist() == [20000, 40000]
    assert log.imu.accel_b[1].tolist() == [0.1, 0.2, -9.7]
    assert log.imu.gyro_b[1].tolist() == [0.01, 0.02, 0.04]
    assert log.seconds == pytest.approx(0.02)
    first, second = log.gnss
    assert (first.t_us, first.fix_type, first.satellites) == (10000, 3, 9)
    assert (first.lat, first.lon, first.alt) == pytest.approx(
        (math.radians(45), math.radians(-93), 250.0)
    )
    assert first.v_l == (1.0, 2.0, -3.0)
    assert first.sigma_h is None
    assert second.satellites is None  # a fix with no satellite: the recorder did not know
    assert second.v_l is not None
    assert math.isnan(second.v_l[2])
    assert log.mag[0].t_us == 20000
    assert log.mag[0].field.tolist() == [268.0, -9.0, -552.0]
    assert [sample.alt for sample in log.baro] == [237.2]
    assert [(fix.yaw, fix.sigma) for fix in log.headings] == [(1.5, None), (1.6, 0.02)]
    assert log.reference is not None
    assert log.reference.source == "reference.csv"
    assert np.isnan(log.reference.lla[0, 0])
    assert np.isnan(log.reference.v_l[0]).all()
    assert_allclose(quat_to_euler(log.reference.q_lb[1]), [0.1, -0.2, -3.1])
    assert log.dropped == {
        "imu all zero": 1,
        "mag all zero": 1,
        "gnss not given": 1,
        "imu not given": 0,
        "mag not given": 0,
        "baro not given": 0,
        "heading not given": 0,
    }
    assert log.counts == {
        "imu.csv": 2,
        "gnss.csv": 2,
        "heading.csv": 2,
        "mag.csv": 1,
        "baro.csv": 1,
    }


def test_a_truth_and_a_reference(tmp_path: Path) -> None:
    folder_of(tmp_path, truth="t_us,yaw\n0,1\n", reference="t_us,yaw\n0,2\n")
    log = read_csv_folder(tmp_path)
    assert log.truth is not None
    assert log.truth.source == "truth.csv"
    assert log.reference is not None
    assert log.reference.source == "reference.csv"
    assert np.isnan(log.truth.q_lb).all()


def test_columns_in_another_order(tmp_path: Path) -> None:
    folder_of(tmp_path, gnss="alt_m,lon_deg,lat_deg,t_us\r\n5,6,7,8\r\n")
    (fix,) = read_csv_folder(tmp_path).gnss
    assert (fix.t_us, fix.alt, fix.v_l, fix.fix_type) == (8, 5.0, None, 3)
    assert math.degrees(fix.lat) == pytest.approx(7.0)


@pytest.mark.parametrize(("suffix", "pack"), [("xz", lzma.compress), ("gz", gzip.compress)])
def test_compressed(tmp_path: Path, suffix: str, pack: Callable[[bytes], bytes]) -> None:
    plain = read_csv_folder(folder_of(tmp_path))
    (tmp_path / "imu.csv").unlink()
    (tmp_path / f"imu.csv.{suffix}").write_bytes(pack((IMU + ROWS).encode()))
    packed = read_csv_folder(tmp_path)
    assert_array_equal(packed.imu.t_us, plain.imu.t_us)
    assert_array_equal(packed.imu.accel_b, plain.imu.accel_b)
    (tmp_path / f"imu.csv.{suffix}").write_bytes(pack((IMU + ROWS).encode())[:-9])
    with pytest.raises(LogFormatError, match=rf"imu.csv.{suffix} is damaged"):
        read_csv_folder(tmp_path)


def test_rows_are_put_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    path = tmp_path / "baro.csv"
    path.write_text("t_us,alt_m\n30,3\n\n10,1\n20,\n")
    table = read_table(path, ("alt_m",))
    assert table.t_us.tolist() == [10, 20, 30]
    assert_array_equal(table.column("alt_m"), [1.0, math.nan, 3.0])
    assert np.isnan(table.column("other")).all()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("0,1,2,3,4,5,6\n20000,1,2,x,4,5,6\n", "line 3, column accel_z: 'x' is not a number"),
        ("0,1,2,3,4,5,6\n\n20000,1,2,3,4\n", "line 4 has 5 columns, the header 7"),
        ("0,1,2,3,4,5\n", "line 2 has 6 columns, the header 7"),
        ("0,1,2,3,4,5,6\n1.5,1,2,3,4,5,6\n", "line 3, column t_us: not a whole number"),
        (",1,2,3,4,5,6\n", "line 2, column t_us: not a whole number"),
        ("-5,1,2,3,4,5,6\n", "line 2, column t_us: not a whole number"),
        ("0,1,2,inf,4,5,6\n", "line 2, column accel_z: not a finite number"),
        ("", "has no IMU samples"),
        ("0,0,0,0,0,0,0\n", "has no IMU samples"),
        ("0,1,2,3,4,5,\n", "has no IMU samples"),
        ("\x00\xff\xfe\n", "line 2 has 1 columns"),
    ],
)
def test_damage_is_named(tmp_path: Path, body: str, message: str) -> None:
    folder_of(tmp_path, imu=IMU + body)
    with pytest.raises(LogFormatError, match=message) as error:
        read_csv_folder(tmp_path)
    assert "imu.csv" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("t_us,alt", "line 1, column 2: 'alt' is not a column of this table"),
        ("t_us,alt_m,alt_m", "line 1, column 3: 'alt_m' is not"),
        ("t_us", "line 1: no column alt_m"),
        ("alt_m", "line 1: no column t_us"),
        ("", "line 1, column 1: '' is not"),
    ],
)
def test_a_wrong_header_is_named(tmp_path: Path, header: str, message: str) -> None:
    folder_of(tmp_path, baro=header + "\n0,1\n")
    with pytest.raises(LogFormatError, match=message):
        read_csv_folder(tmp_path)


def test_a_folder_without_imu(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match=r"holds no imu\.csv"):
        read_csv_folder(tmp_path)


def test_the_flights_are_read(shared: Callable[[str], Path]) -> None:
    fixed_wing = read_csv_folder(shared("data/flights/fixedwing_umn_thor75"))
    assert (len(fixed_wing.imu), len(fixed_wing.gnss)) == (34811, 674)
    assert fixed_wing.dropped["imu all zero"] == 1
    assert fixed_wing.dropped["mag all zero"] == 1
    assert fixed_wing.reference is not None
    assert int(np.isnan(fixed_wing.reference.lla[:, 0]).sum()) == 2282
    copter = read_csv_folder(shared("data/flights/quad_apm_122a"))
    assert (len(copter.imu), len(copter.gnss), len(copter.mag)) == (18004, 2001, 3619)
    assert all(fix.satellites is None for fix in copter.gnss)
    assert copter.reference is not None
    assert np.isnan(copter.reference.v_l).all()
