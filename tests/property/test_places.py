"""Places on the Earth: geodetic, Cartesian and tangent coordinates name the same points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mavins.nav import earth
from mavins.types import Origin

pytestmark = pytest.mark.jit

LAT = st.floats(-math.pi / 2 + 1e-6, math.pi / 2 - 1e-6)
LON = st.floats(-math.pi, math.pi)
ALT = st.floats(-500.0, 20_000.0)
OFFSET = st.tuples(*[st.floats(-300e3, 300e3)] * 2, st.floats(-10e3, 10e3))
NEAR_POLE = st.floats(1e-9, 1e-3).map(lambda colatitude: math.pi / 2 - colatitude)


@given(LAT | NEAR_POLE, LON, ALT)
def test_ecef_and_back(lat: float, lon: float, alt: float) -> None:
    back = earth.ecef_to_lla(earth.lla_to_ecef(lat, lon, alt))
    assert back[0] == pytest.approx(lat, abs=1e-13)
    # at the pole a metre is many radians of longitude
    gap = math.remainder(back[1] - lon, 2 * math.pi) * math.cos(lat)
    assert gap == pytest.approx(0.0, abs=1e-13)
    assert back[2] == pytest.approx(alt, abs=1e-8)


@given(LAT, LON, ALT, OFFSET)
def test_tangent_frame_and_back(
    lat: float, lon: float, alt: float, offset: tuple[float, float, float]
) -> None:
    frame = earth.TangentFrame.at(Origin(lat, lon, alt))
    p_n = np.array(offset)
    assert_allclose(frame.from_lla(*frame.to_lla(p_n)), p_n, atol=5e-8)


@given(LAT, LON, ALT)
def test_the_origin_is_zero_and_its_axes_are_north_east_down(
    lat: float, lon: float, alt: float
) -> None:
    frame = earth.TangentFrame.at(Origin(lat, lon, alt))
    assert_allclose(frame.from_lla(lat, lon, alt), np.zeros(3), atol=1e-8)
    assert_allclose(frame.from_lla(lat, lon, alt + 100.0), [0.0, 0.0, -100.0], atol=1e-7)
    if abs(lat) < 1.5:
        north = frame.from_lla(lat + 1e-5, lon, alt)
        east = frame.from_lla(lat, lon + 1e-5, alt)
        assert north[0] > 60.0
        assert abs(north[1]) < 1e-6
        assert east[1] > 4.0
        assert abs(east[0]) < 0.01


@given(LAT, LON, ALT, OFFSET)
def test_gravity_is_plumb_everywhere(
    lat: float, lon: float, alt: float, offset: tuple[float, float, float]
) -> None:
    frame = earth.TangentFrame.at(Origin(lat, lon, alt))
    p_n = np.array(offset)
    here = frame.to_lla(p_n)
    g_l = frame.local_level(here[0], here[1]) @ earth.gravity_n(p_n, frame.r0_e, frame.C_ne)
    assert_allclose(g_l[:2], 0.0, atol=1e-9)
    assert 9.6 < g_l[2] < 9.9


@given(LAT, LON, OFFSET)
def test_distances_do_not_depend_on_the_frame(
    lat: float, lon: float, offset: tuple[float, float, float]
) -> None:
    frame = earth.TangentFrame.at(Origin(lat, lon, 0.0))
    a, b = frame.to_lla(np.array(offset)), frame.to_lla(np.array([100.0, 200.0, 300.0]))
    other = earth.TangentFrame.at(Origin(*b))
    expected = float(np.linalg.norm(np.array(offset) - [100.0, 200.0, 300.0]))
    assert np.linalg.norm(other.from_lla(*a)) == pytest.approx(expected, abs=1e-7)
