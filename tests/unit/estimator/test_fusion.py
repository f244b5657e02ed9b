"""Gate, track and the reset rule, on a filter that stands at the origin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading, zero_velocity
from mavins.estimator.fusion import Event, Fusion, Track
from mavins.filters import FilterState, ImuNoise, make
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_SIZE
from mavins.types import GnssFix, HeadingFix, Origin

FRAME = TangentFrame.at(Origin(0.8, 0.15, 500.0))
AFTER = 7.0


def fix_at(p_n: tuple[float, float, float], t_us: int, v_l: tuple[float, float, float]) -> GnssFix:
    lat, lon, alt = FRAME.to_lla(np.array(p_n))
    return GnssFix(t_us, float(lat), float(lon), float(alt), v_l, 3)


def position(t_us: int, offset: float, quality: str = "") -> Measurement:
    fix = fix_at((offset, 0.0, 0.0), t_us, (0.0, 0.0, 0.0))
    return gnss_position.measure(fix, t_us, FRAME, 0.5, 0.8, 5.0, quality)


def velocity(t_us: int, v_l: tuple[float, float, float]) -> Measurement:
    m = gnss_velocity.measure(fix_at((0.0, 0.0, 0.0), t_us, v_l), t_us, FRAME, 0.1, 5.0)
    assert m is not None
    return m


def state() -> FilterState:
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    P = np.diag(np.repeat([0.3, 0.1, 0.02, 0.01, 0.1], 3) ** 2)
    P[0, 3] = P[3, 0] = 0.01
    return FilterState(x, P, np.array([0, 0, 0, 0, 0, -9.81]), 0)


def fusion() -> Fusion:
    return Fusion(make("eskf", ImuNoise(0.01, 0.1, 1e-4, 1e-3)), AFTER)


def fuse(f: Fusion, s: FilterState, m: Measurement) -> Event:
    event = Event(m, (m.t_us, m.rank, m.source, 0))
    f.fuse(s, event)
    return event


def test_what_fits_is_fused_and_remembered() -> None:
    f, s = fusion(), state()
    event = fuse(f, s, position(1_000_000, 0.4))
    assert event.accepted
    assert event.nis == pytest.approx(0.4**2 / (0.3**2 + 0.5**2), rel=1e-6)
    assert_allclose(event.innovation, [0.4, 0.0, 0.0], atol=1e-6)
    assert_allclose(event.sigma, np.hypot(0.3, [0.5, 0.5, 0.8]), rtol=1e-6)
    assert 0.0 < s.x[0] < 0.4
    assert f.track == Track((1_000_000, -1, -1))


def test_what_does_not_fit_leaves_only_its_reason() -> None:
    f, s = fusion(), state()
    before = s.copy()
    event = fuse(f, s, position(1_000_000, 100.0))
    assert event.reason == "gate"
    assert_array_equal(s.x, before.x)
    assert_array_equal(s.P, before.P)
    assert f.track.rejected_since_us == (1_000_000, -1)


def test_what_is_not_trusted_is_not_used_but_judged() -> None:
    f, s = fusion(), state()
    before = s.copy()
    event = fuse(f, s, position(1_000_000, 0.1, "few satellites"))
    assert event.reason == "few satellites"
    assert event.nis > 0.0
    assert_array_equal(s.P, before.P)
    assert f.track == Track()


def test_position_is_reset_after_seven_seconds_of_refusal() -> None:
    f, s = fusion(), state()
    reasons = [fuse(f, s, position(k * 200_000, 100.0)).reason for k in range(1, 40)]
    k = reasons.index("reset")
    assert set(reasons[:k]) == {"gate"}
    assert k == 35
    assert f.track.resets == 1
    assert f.track.reset_times_us == (7_200_000,)
    assert f.track.rejected_since_us == (-1, -1)
    # the fixes after the reset fit
    assert set(reasons[k + 1 :]) == {""}
    assert s.x[0] == pytest.approx(100.0, abs=1e-6)


def test_a_reset_forgets_what_was_known_of_the_position() -> None:
    f, s = fusion(), state()
    for k in range(1, 36):
        fuse(f, s, position(k * 200_000, 100.0))
    before = s.copy()
    m = position(7_200_000, 100.0)
    assert fuse(f, s, m).reason == "reset"
    assert_allclose(s.P[:3, :3], m.R)
    assert_array_equal(s.P[:3, 3:], 0.0)
    assert_array_equal(s.P[3:, 3:], before.P[3:, 3:])
    assert_array_equal(s.P, s.P.T)


def test_one_fix_that_fits_starts_the_count_again() -> None:
    f, s = fusion(), state()
    for k in range(1, 60):
        event = fuse(f, s, position(k * 200_000, 0.0 if k % 30 == 0 else 100.0))
        assert event.reason != "reset"
    assert f.track.resets == 0


def test_a_silence_starts_the_count_again() -> None:
    f, s = fusion(), state()
    assert fuse(f, s, position(1_000_000, 100.0)).reason == "gate"
    late = range(9_000_000, 16_000_000, 200_000)
    assert {fuse(f, s, position(t_us, 100.0)).reason for t_us in late} == {"gate"}
    assert fuse(f, s, position(16_000_000, 100.0)).reason == "reset"


def test_velocity_is_reset_in_the_axes_that_are_measured() -> None:
    f, s = fusion(), state()
    s.x[5] = 0.7
    for k in range(1, 37):
        event = fuse(f, s, velocity(k * 200_000, (20.0, -5.0, math.nan)))
    assert event.reason == "reset"
    assert_allclose(s.x[3:6], [20.0, -5.0, 0.7], atol=1e-5)
    assert_allclose(s.P[3:5, 3:5], np.eye(2) * 0.01, atol=1e-12)
    assert s.P[5, 5] == pytest.approx(0.01)


def test_heading_and_zero_velocity_are_never_reset_to() -> None:
    f, s = fusion(), state()
    for k in range(1, 100):
        t_us = k * 200_000
        turned = heading.measure(HeadingFix(t_us, 2.0), t_us, FRAME, 0.05, 5.0)
        assert fuse(f, s, turned).reason == "gate"
        s.x[3] = 30.0
        assert fuse(f, s, zero_velocity.measure(t_us, t_us, 0.1, 5.0)).reason == "gate"
    assert f.track.resets == 0


def test_the_times_of_the_last_resets_are_kept() -> None:
    f, s = fusion(), state()
    where = 0.0
    for k in range(1, 500):
        if k % 40 == 0:
            where += 1000.0
        fuse(f, s, position(k * 200_000, where))
    assert f.track.resets > 8
    assert len(f.track.reset_times_us) == 8
