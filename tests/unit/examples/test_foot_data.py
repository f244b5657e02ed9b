"""Recordings of an IMU on a foot: axes, units, times, and files that are not one."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.errors import LogFormatError
from mavins.examples.foot_data import read_openshoe, read_vicon

LATE = np.array([0.0, 0.003, -0.001, 0.02, 0.0, 0.0, 0.02, -0.001, 0.003, 0.0])
"""The same forwards and backwards, so that it does not tilt the line."""


def openshoe_line(number: int, time: float) -> str:
    force, rate = "+0.10000000 -0.20000000 +0.99000000", "+1.00000000 +2.00000000 -3.00000000"
    stamps = f"{time:.6f} {time:.6f} {time + 0.002:.6f}"
    return f"   0xcb {force} {rate} 18871475 0x1517 {number} {stamps} 249.490045 0 0 -0.4 \n"


def test_openshoe_is_turned_into_forward_right_down_and_si(tmp_path: Path) -> None:
    path = tmp_path / "loop_7.txt.xz"
    lines = [openshoe_line(996 + k, 1.274e9 + 0.004 * k + late) for k, late in enumerate(LATE)]
    with lzma.open(path, "wt") as file:
        file.writelines(["\n", "Inertial data.\n", *lines, "   0xcb +0.1 cut\n"])
    recording = read_openshoe(path)
    assert recording.name == "loop_7"
    assert recording.truth is None
    assert_allclose(
        recording.imu, np.tile([1.0, -2.0, 3.0, 0.980665, 1.96133, -9.7085835], (10, 1))
    )
    # the jitter of the stamps is not in the times
    assert recording.t_us[0] == 0
    assert_allclose(np.diff(recording.t_us), 4000, atol=1)


def test_vicon_is_turned_into_rates_first_and_microseconds(tmp_path: Path) -> None:
    path = tmp_path / "trial.npz"
    imu = np.arange(12.0).reshape(2, 6)
    truth = np.array([[1.0, 2.0], [3.0, 4.0]])
    np.savez(path, imu=imu, gt=truth, t=np.array([[5.0], [5.0049996]]))
    recording = read_vicon(path)
    assert recording.name == "trial"
    assert recording.t_us.tolist() == [0, 5000]
    assert_allclose(recording.imu[1], [9.0, 10.0, 11.0, 6.0, 7.0, 8.0])
    assert recording.truth is not None
    assert_allclose(recording.truth, truth)


def test_another_file_is_refused_by_name(tmp_path: Path) -> None:
    text = tmp_path / "loop_1.txt.xz"
    with lzma.open(text, "wt") as file:
        file.write("nothing of the kind\n")
    with pytest.raises(LogFormatError, match="loop_1"):
        read_openshoe(text)
    with lzma.open(text, "wt") as file:
        file.writelines(openshoe_line(k, 0.0).replace("+1.0", "one") for k in range(3))
    with pytest.raises(LogFormatError, match="loop_1"):
        read_openshoe(text)
    text.write_text("not compressed")
    with pytest.raises(LogFormatError, match="loop_1"):
        read_openshoe(text)
    npz = tmp_path / "trial.npz"
    np.savez(npz, imu=np.zeros((2, 6)))
    with pytest.raises(LogFormatError, match="trial"):
        read_vicon(npz)
