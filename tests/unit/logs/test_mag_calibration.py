"""Mounting and hard iron of a magnetometer from turns that gyros saw."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.logs.mag_calibration import calibrate, turns
from mavins.nav.so3 import euler_to_quat, quat_exp, quat_mul, quat_to_dcm
from mavins.types import FloatArray, IntArray

FIELD_N = np.array([0.3, 0.05, 0.9])
SECONDS = 60


def flight(
    tilting: float, yawing: float, seed: int = 1
) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    """Stamps and rates of gyros at 50 Hz, and stamps and fields in b at 10 Hz of a vehicle that sways and turns."""
    rng = np.random.default_rng(seed)
    t_us = np.arange(0, SECONDS * 1_000_000, 20_000)
    t = t_us * 1e-6
    gyro = np.column_stack(
        [tilting * np.sin(0.9 * t), tilting * np.cos(1.3 * t), yawing * np.sin(0.2 * t)]
    )
    q = np.array([1.0, 0.0, 0.0, 0.0])
    fields = np.empty((len(t), 3))
    for k in range(len(t)):
        fields[k] = quat_to_dcm(q).T @ FIELD_N
        if k + 1 < len(t):
            q = quat_mul(q, quat_exp((gyro[k] + gyro[k + 1]) * 0.01))
    fields += rng.normal(size=fields.shape) * 0.003
    return t_us, gyro + 0.002 + rng.normal(size=gyro.shape) * 0.005, t_us[::5], fields[::5]


def test_turns_are_the_attitudes_at_any_instant() -> None:
    t_us = np.arange(0, 1_000_000, 10_000)
    gyro = np.tile([0.0, 0.0, 1.0], (len(t_us), 1))
    q = turns(t_us, gyro, np.array([0, 333_333, 905_000]), np.array([1.0, 0.0, 0.0, 0.0]))
    assert_allclose(q[:, 3], np.sin(0.5 * np.array([0.0, 0.333333, 0.905])), atol=1e-9)


def test_pieces_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = calibrate(*flight(0.5, 1.0))
    for piece in (1, 7, 100):
        monkeypatch.setattr("mavins.logs.mag_calibration._PIECE", piece)
        assert calibrate(*flight(0.5, 1.0)) == whole


@pytest.mark.parametrize("scale", [1.0, 600.0])
@pytest.mark.parametrize(
    "rotation", [(0.0, 0.0, 0.0), (math.pi, 0.0, 0.0), (0.0, 0.0, -math.pi / 2)]
)
def test_mounting_and_hard_iron_are_found(
    rotation: tuple[float, float, float], scale: float
) -> None:
    t_us, gyro, mag_us, field_b = flight(0.4, 1.0)
    R = quat_to_dcm(euler_to_quat(*rotation))
    hard_iron = np.array([0.4, -0.2, 0.3])
    found = calibrate(t_us, gyro, mag_us, scale * (field_b @ R + hard_iron))
    assert_allclose(quat_to_dcm(euler_to_quat(*found.rotation)), R, atol=1e-12)
    assert_allclose(np.array(found.hard_iron) / scale, hard_iron, atol=0.02)


def test_a_slow_magnetometer_will_do() -> None:
    t_us, gyro, mag_us, field_b = flight(0.4, 1.0)
    found = calibrate(t_us, gyro, mag_us[::5], field_b[::5] + np.array([0.4, -0.2, 0.3]))
    assert_allclose(found.hard_iron, [0.4, -0.2, 0.3], atol=0.04)


def test_a_mounting_that_is_given_is_kept() -> None:
    t_us, gyro, mag_us, field_b = flight(0.4, 1.0)
    rotation = (0.3, 0.0, 0.0)
    R = quat_to_dcm(euler_to_quat(*rotation))
    found = calibrate(t_us, gyro, mag_us, field_b @ R + [0.1, 0.0, 0.0], rotation)
    assert found.rotation == rotation
    assert_allclose(found.hard_iron, [0.1, 0.0, 0.0], atol=0.02)


def test_turning_level_shows_nothing_of_the_vertical() -> None:
    t_us, gyro, mag_us, field_b = flight(0.0, 1.0)
    found = calibrate(t_us, gyro, mag_us, field_b + np.array([0.2, -0.1, 0.5]))
    assert_allclose(found.hard_iron[:2], [0.2, -0.1], atol=0.02)
    assert abs(found.hard_iron[2]) < 0.1


def test_standing_shows_nothing() -> None:
    t_us, gyro, mag_us, field_b = flight(0.0, 0.0)
    found = calibrate(t_us, gyro, mag_us, field_b)
    assert found.rotation == (0.0, 0.0, 0.0)
    assert_allclose(found.hard_iron, 0.0, atol=0.1)


@pytest.mark.parametrize("n", [0, 1, 5])
def test_too_few_readings(n: int) -> None:
    t_us, gyro, mag_us, field_b = flight(0.4, 1.0)
    found = calibrate(t_us, gyro, mag_us[:n], field_b[:n])
    assert (found.rotation, found.hard_iron) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
