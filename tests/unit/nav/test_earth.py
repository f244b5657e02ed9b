"""The Earth: published values of gravity, exact frames, and the gradient against differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.nav import earth
from mavins.types import Origin

PLACES = [(0.0, 0.0, 0.0), (47.4, 8.5, 488.0), (-33.9, 151.2, 20.0), (89.9, -120.0, 3000.0)]


def frame_at(lat_deg: float, lon_deg: float, alt: float) -> earth.TangentFrame:
    return earth.TangentFrame.at(Origin(math.radians(lat_deg), math.radians(lon_deg), alt))


@pytest.mark.parametrize(
    ("lat_deg", "gravity"),
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (-90.0, 9.8321849378), (45.0, 9.806197769)],
)
def test_gravity_on_the_ellipsoid(lat_deg: float, gravity: float) -> None:
    g = earth.normal_gravity(math.sin(math.radians(lat_deg)), 0.0)
    assert g == pytest.approx(gravity, abs=2e-8)


def test_gravity_falls_with_height() -> None:
    s = math.sin(math.radians(45.0))
    fall = earth.normal_gravity(s, 0.0) - earth.normal_gravity(s, 1000.0)
    assert fall == pytest.approx(3.0852e-3, abs=1e-6)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("p_n", [(0.0, 0.0, 0.0), (1e4, -2e4, -500.0)])
def test_gravity_points_down_the_plumb_line(
    place: tuple[float, ...], p_n: tuple[float, ...]
) -> None:
    frame = frame_at(*place)
    p = np.array(p_n)
    lat, lon, alt = frame.to_lla(p)
    g_l = frame.local_level(lat, lon) @ earth.gravity_n(p, frame.r0_e, frame.C_ne)
    expected = earth.normal_gravity(math.sin(lat), alt)
    assert_allclose(g_l, [0.0, 0.0, expected], atol=1e-12)


def test_gravity_at_the_pole_itself() -> None:
    frame = frame_at(90.0, 0.0, 10.0)
    g_n = earth.gravity_n(np.zeros(3), frame.r0_e, frame.C_ne)
    assert_allclose(g_n, [0.0, 0.0, earth.normal_gravity(1.0, 10.0)], atol=1e-9)


@pytest.mark.parametrize("place", PLACES)
def test_gravity_gradient_to_a_percent(place: tuple[float, ...]) -> None:
    frame = frame_at(*place)
    p, h = np.array([3e3, 1e3, -200.0]), 100.0

    def g(d: np.ndarray) -> np.ndarray:
        return earth.gravity_n(p + d, frame.r0_e, frame.C_ne)

    numeric = np.column_stack([(g(h * e) - g(-h * e)) / (2 * h) for e in np.eye(3)])
    G = np.empty((3, 3))
    earth.write_gravity_gradient(G, *g(np.zeros(3)))
    assert_allclose(G, numeric, atol=0.012 * np.abs(numeric).max())


@pytest.mark.parametrize("place", PLACES)
def test_the_earth_s_rate_points_north_and_up(place: tuple[float, ...]) -> None:
    frame = frame_at(*place)
    lat = math.radians(place[0])
    expected = earth.EARTH_RATE * np.array([math.cos(lat), 0.0, -math.sin(lat)])
    assert_allclose(frame.w_ie_n, expected, atol=1e-20)


@pytest.mark.parametrize("place", PLACES)
def test_frames_are_rotations(place: tuple[float, ...]) -> None:
    frame = frame_at(*place)
    C = frame.local_level(math.radians(place[0]) + 0.01, math.radians(place[1]) + 0.02)
    for M in (frame.C_ne, C):
        assert_allclose(M @ M.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(M) == pytest.approx(1.0)
    here = frame.local_level(math.radians(place[0]), math.radians(place[1]))
    assert_allclose(here, np.eye(3), atol=1e-15)


def test_the_tangent_plane_s_drop_at_ten_kilometres() -> None:
    frame = frame_at(47.4, 8.5, 0.0)
    assert frame.to_lla(np.array([1e4, 0.0, 0.0]))[2] == pytest.approx(7.84, abs=0.02)


def test_a_known_point_in_ecef() -> None:
    # the equator's radius and the polar one
    assert_allclose(earth.lla_to_ecef(0.0, 0.0, 0.0), [6378137.0, 0.0, 0.0])
    assert_allclose(earth.lla_to_ecef(math.pi / 2, 0.0, 0.0), [0, 0, 6356752.314245], atol=1e-6)


def test_latitude_and_height_on_the_axis() -> None:
    lat, _, alt = earth.ecef_to_lla(np.array([0.0, 0.0, -6356752.314245 - 100.0]))
    assert lat == pytest.approx(-math.pi / 2)
    assert alt == pytest.approx(100.0, abs=1e-5)
