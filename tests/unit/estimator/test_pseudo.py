"""What is known of the motion without a sensor: only where it is switched on and holds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.estimator.aiding_settings import GravityTiltSettings, NonholonomicSettings
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.pseudo import gravity_tilt_at, nonholonomic_at
from mavins.nav.earth import TangentFrame
from mavins.types import Origin

FRAME = TangentFrame.at(Origin(0.8, 0.15, 500.0))
NOW = 1_000_000


def readings(*row: float) -> ImuBuffer:
    buffer = ImuBuffer()
    t_us = np.arange(10_000, NOW + 1, 10_000)
    buffer.append(t_us, np.tile(row, (len(t_us), 1)))
    return buffer


def test_at_rest_the_mean_is_measured_in_the_middle_of_the_window() -> None:
    buffer = readings(0.01, 0.0, 0.0, 0.5, 0.0, -9.8)
    m = gravity_tilt_at(NOW, buffer, FRAME, GravityTiltSettings(enabled=True, sigma=0.3))
    assert m is not None
    assert (m.stamp_us, m.t_us) == (NOW, NOW - 250_000)
    assert_allclose(m.z, [0.5, 0.0, -9.8])
    assert_allclose(m.R, np.eye(3) * 0.09)


@pytest.mark.parametrize(
    ("row", "enabled"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0, -9.8), False),
        ((0.0, 0.0, 0.0, 3.0, 0.0, -9.8), True),
        ((0.0, 0.0, 0.0, 0.0, 0.0, -9.0), True),
        ((0.0, 0.0, 0.2, 0.0, 0.0, -9.8), True),
    ],
)
def test_not_while_accelerating_turning_or_off(row: tuple[float, ...], enabled: bool) -> None:
    assert gravity_tilt_at(NOW, readings(*row), FRAME, GravityTiltSettings(enabled=enabled)) is None


def test_not_across_a_gap() -> None:
    buffer = ImuBuffer()
    buffer.append(np.array([NOW]), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -9.8]]))
    assert gravity_tilt_at(NOW, buffer, FRAME, GravityTiltSettings(enabled=True)) is None


def test_wheels() -> None:
    assert nonholonomic_at(NOW, NonholonomicSettings()) is None
    m = nonholonomic_at(NOW, NonholonomicSettings(enabled=True, lever_arm=(-1.0, 0.0, 0.5)))
    assert m is not None
    assert (m.stamp_us, m.t_us) == (NOW, NOW)
    assert_allclose(m.parameters, [-1.0, 0.0, 0.5])
    assert_allclose(m.z, [0.0, 0.0])
