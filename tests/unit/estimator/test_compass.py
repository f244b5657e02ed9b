"""A magnetometer's readings: direction, reference field, and the heading of the levelled field."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.errors import ConfigError
from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.aligner import Aligner
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.compass import Compass, levelled, world_magnetic_model
from mavins.estimator.settings import Settings
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import GnssFix, MagSample, Origin

ON = MagnetometerSettings(enabled=True)
GIVEN = replace(ON, declination_deg=10.0, inclination_deg=60.0)
FIELD_L = np.array(
    [
        0.5 * math.cos(math.radians(10.0)),
        0.5 * math.sin(math.radians(10.0)),
        math.sin(math.radians(60.0)),
    ]
)


def sample(t_us: int, *field: float) -> MagSample:
    return MagSample(t_us, np.array(field))


@pytest.mark.parametrize("scale", [1e-4, 0.5, 600.0])
def test_only_the_direction_is_taken_whatever_the_unit(scale: float) -> None:
    settings = replace(ON, rotation=(math.pi, 0.0, 0.0), hard_iron=(scale * 0.2, 0.0, scale * -0.1))
    direction = Compass(settings).direction_b(sample(0, 0.5 * scale, 0.4 * scale, -0.1 * scale))
    assert direction is not None
    assert_allclose(direction, [0.6, -0.8, 0.0], atol=1e-12)


def test_no_more_than_the_highest_rate_and_no_zeros() -> None:
    compass = Compass(ON)
    stamps = [0, 20_000, 490_000, 510_000, 980_000, 1_000_000]
    taken = [t for t in stamps if compass.direction_b(sample(t, 1.0, 0.0, 0.0)) is not None]
    assert taken == [0, 490_000, 980_000]
    assert compass.direction_b(sample(9_000_000, 0.0, 0.0, 0.0)) is None
    assert compass.direction_b(sample(9_000_000, math.nan, 0.0, 0.0)) is None


@pytest.mark.parametrize("enabled", [False, "auto"])
def test_off(enabled: bool | str) -> None:
    compass = Compass(replace(ON, enabled=enabled))
    assert compass.direction_b(sample(0, 1.0, 0.0, 0.0)) is None


def test_reference_as_configured_and_at_the_origin() -> None:
    compass = Compass(GIVEN)
    assert_allclose(compass.reference_l(0.8, 0.1, 0.0), FIELD_L)
    assert_allclose(compass.reference_n(TangentFrame.at(Origin(0.8, 0.15, 500.0))), FIELD_L)


def test_world_magnetic_model() -> None:
    """A test value of the WMM2020 report: 2020.0, at sea level, 0 N 120 E."""
    pytest.importorskip("pygeomag")
    declination, inclination = world_magnetic_model(0.0, math.radians(120.0), 0.0, 2020.0)
    assert declination == pytest.approx(0.16, abs=0.006)
    assert inclination == pytest.approx(-15.42, abs=0.006)


def test_without_the_package_the_error_says_how_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygeomag", None)
    with pytest.raises(ConfigError, match=r"pip install 'mavins\[mag\]'.*declination_deg"):
        Compass(ON).reference_l(0.123, 0.1, 0.0)


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 1.5, 3.1])
@pytest.mark.parametrize("push", [(0.0, 0.0, -9.8), (2.0, -1.0, -9.0)])
def test_levelled_field_gives_the_yaw(yaw: float, push: tuple[float, float, float]) -> None:
    C = quat_to_dcm(euler_to_quat(0.2, -0.3, yaw))
    push_l = np.array(push)
    found, dip = levelled(C.T @ FIELD_L, C.T @ push_l, push_l, FIELD_L)
    assert math.remainder(found - yaw, 2 * math.pi) == pytest.approx(0.0, abs=2e-3)
    assert dip == pytest.approx(math.radians(60.0), abs=2e-3)


def aligned(field_l: np.ndarray) -> object:
    """What an aligner makes of a second at rest, three fixes and one field."""
    settings = Settings(magnetometer=GIVEN)
    aligner = Aligner(settings)
    buffer = ImuBuffer()
    C = quat_to_dcm(euler_to_quat(0.05, -0.02, 2.0))
    t_us = np.arange(0, 1_500_000, 10_000)
    buffer.append(t_us, np.tile([0.0, 0.0, 0.0, *(C.T @ [0.0, 0.0, -9.81])], (len(t_us), 1)))
    for t in (1_200_000, 1_300_000, 1_400_000):
        aligner.see_fix(GnssFix(t, 0.8, 0.15, 500.0, (0.0, 0.0, 0.0), 3), t)
    aligner.see_field(C.T @ field_l, 1_450_000)
    return aligner.candidate(buffer, 1_490_000, 1_000_000)


def test_the_field_aligns_where_no_heading_comes() -> None:
    candidate = aligned(FIELD_L)
    assert not isinstance(candidate, str)
    heading = candidate.heading  # type: ignore[attr-defined]
    assert heading.source == "magnetometer"
    assert heading.yaw == pytest.approx(2.0, abs=1e-6)
    # what sigma makes of the horizontal half of the field, and what levelling may add
    assert heading.sigma == pytest.approx(
        math.hypot(0.15, math.radians(4.0) * 0.866) / 0.5, rel=1e-3
    )


def test_a_field_that_points_elsewhere_does_not_align() -> None:
    assert aligned(FIELD_L * [1.0, 1.0, -1.0]) == (
        "magnetometer: dip -60 deg, the Earth's field has 60"
    )
