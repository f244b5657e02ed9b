"""Health, alignment and jumps of the estimator, on a vehicle that stands or hovers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.estimator.aiding_settings import (
    GravityTiltSettings,
    NonholonomicSettings,
    ZeroVelocitySettings,
)
from mavins.estimator.estimator import Estimator
from mavins.estimator.settings import ImuSettings, Settings
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import GnssFix, HeadingFix, Health, ImuTable, NavSolution, Origin

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

ORIGIN = Origin(0.8, 0.15, 500.0)
ATTITUDE = (0.05, -0.08, 1.0)
FRAME = TangentFrame.at(ORIGIN)


class Vehicle:
    """Feeds an estimator: IMU at 100 Hz, fixes at 5 Hz and headings at 10 Hz where they are wanted."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.estimator = Estimator(settings or Settings())
        self.t_us = 1_000_000
        self.rng = np.random.default_rng(3)
        self.p_n = np.zeros(3)
        self.gyro_bias = np.zeros(3)

    def go(self, seconds: float, *, fixes: bool = True, headings: bool = True, **fix: Any) -> None:
        C = quat_to_dcm(euler_to_quat(*ATTITUDE))
        f_b = C.T @ [0.0, 0.0, -9.808]
        for _ in range(round(seconds * 100)):
            self.t_us += 10_000
            accel = f_b + self.rng.normal(size=3) * 0.05
            gyro = self.gyro_bias + self.rng.normal(size=3) * 0.005
            table = ImuTable(np.array([self.t_us]), accel[np.newaxis], gyro[np.newaxis])
            self.estimator.feed_imu(table)
            if headings and self.t_us % 100_000 == 0:
                self.estimator.feed_heading(HeadingFix(self.t_us, ATTITUDE[2], 0.05))
            if fixes and self.t_us % 200_000 == 0:
                self.estimator.feed_gnss(self.fix(**fix))

    def fix(self, **change: Any) -> GnssFix:
        lat, lon, alt = FRAME.to_lla(self.p_n)
        values = {"v_l": (0.0, 0.0, 0.0), "fix_type": 3, "satellites": 12, **change}
        return GnssFix(self.t_us, float(lat), float(lon), float(alt), **values)

    @property
    def solution(self) -> NavSolution:
        solution = self.estimator.solution()
        assert solution is not None
        return solution


def test_it_waits_then_runs_from_level_and_heading() -> None:
    v = Vehicle()
    assert v.estimator.health is Health.WAITING
    assert v.estimator.solution() is None
    v.go(0.5, fixes=False, headings=False)
    assert v.estimator.health is Health.WAITING
    v.go(6.0)
    assert v.estimator.health is Health.RUNNING
    assert v.estimator.reason == ""
    s = v.solution
    assert_allclose([s.roll, s.pitch, s.yaw], ATTITUDE, atol=0.02)
    assert_allclose([s.lat, s.lon], [ORIGIN.lat, ORIGIN.lon], atol=1e-7)
    assert s.alt == pytest.approx(500.0, abs=0.5)
    assert s.t_us == v.t_us


def test_without_a_heading_it_aligns_for_ever_and_says_why() -> None:
    v = Vehicle()
    v.go(10.0, headings=False)
    assert v.estimator.health is Health.ALIGNING
    assert v.estimator.reason == "no heading source: waiting for motion"


def test_bad_fixes_do_not_start_it() -> None:
    v = Vehicle()
    v.go(5.0, satellites=3)
    assert not v.estimator.running
    assert v.estimator.reason == "GNSS: few satellites"


def test_it_reckons_without_fixes_and_comes_back() -> None:
    v = Vehicle()
    v.go(6.0)
    v.go(4.0, fixes=False)
    assert v.estimator.health is Health.DEAD_RECKONING
    assert "no GNSS" in v.estimator.reason
    v.go(1.0)
    assert v.estimator.health is Health.RUNNING
    assert v.estimator.reset_counter == 0


def test_bad_fixes_in_flight_are_counted_with_their_reason() -> None:
    v = Vehicle()
    v.go(6.0)
    before = v.solution.p_n.copy()
    v.p_n = np.array([500.0, 0.0, 0.0])
    v.go(2.0, fix_type=1)
    assert_allclose(v.solution.p_n, before, atol=0.5)
    v.estimator.finish()
    assert v.estimator.statistics["gnss_position"].rejected["no 3D fix"] == 10


def test_a_jump_of_gnss_is_refused_then_taken_over() -> None:
    v = Vehicle()
    v.go(6.0)
    v.p_n = np.array([100e3, 0.0, 0.0])
    v.go(5.0)
    assert np.linalg.norm(v.solution.p_n) < 5.0
    assert v.estimator.health is Health.DEAD_RECKONING or v.estimator.reset_counter == 0
    v.go(4.0)
    assert v.estimator.reset_counter == 1
    assert v.solution.reset_counter == 1
    assert np.linalg.norm(v.solution.p_n - v.p_n) < 5.0


@pytest.mark.parametrize(("gap", "lost"), [(0.15, False), (1.5, False), (2.5, True), (10.0, True)])
def test_a_gap_between_samples(gap: float, lost: bool) -> None:
    v = Vehicle()
    v.go(6.0)
    v.t_us += round(gap * 1e6)
    v.go(0.1)
    assert v.estimator.running is not lost
    v.go(6.0)
    assert v.estimator.running
    assert v.estimator.realignments == int(lost)
    assert np.linalg.norm(v.solution.p_n - v.p_n) < 3.0


def test_repeated_samples_are_counted_once() -> None:
    v = Vehicle()
    v.go(6.0)
    before = v.solution
    again = ImuTable(np.array([v.t_us]), np.full((1, 3), 7.0), np.full((1, 3), 7.0))
    v.estimator.feed_imu(again)
    assert v.estimator.dropped["IMU repeated"] == 1
    assert np.array_equal(v.solution.q_nb, before.q_nb)


def test_an_old_sample_is_left_out() -> None:
    v = Vehicle()
    v.go(6.0)
    old = ImuTable(np.array([v.t_us - 1_500_001]), np.ones((1, 3)), np.ones((1, 3)))
    v.estimator.feed_imu(old)
    assert v.estimator.dropped["IMU too old"] == 1


def test_a_new_origin_carries_the_estimate_over() -> None:
    v = Vehicle()
    v.go(6.0)
    before = v.solution
    v.estimator.set_origin(Origin(0.801, 0.151, 400.0))
    after = v.solution
    assert_allclose([after.lat, after.lon], [before.lat, before.lon], atol=1e-12)
    assert after.alt == pytest.approx(before.alt, abs=1e-6)
    assert_allclose(after.v_l, before.v_l, atol=1e-9)
    assert_allclose(after.q_lb, before.q_lb, atol=1e-9)
    assert np.linalg.norm(after.p_n) > 5e3
    assert after.reset_counter == before.reset_counter + 1
    v.go(2.0)
    assert v.solution.alt == pytest.approx(500.0, abs=0.5)


def test_an_origin_that_was_asked_for_before_the_start() -> None:
    v = Vehicle()
    v.estimator.set_origin(Origin(0.8, 0.15, 0.0))
    v.go(6.0)
    assert v.solution.p_n[2] == pytest.approx(-500.0, abs=0.5)
    assert v.solution.reset_counter == 0


def test_a_reboot_starts_anew_in_the_same_frame() -> None:
    v = Vehicle()
    v.go(6.0)
    frame = v.estimator.frame
    v.estimator.restart("the vehicle has rebooted")
    assert not v.estimator.running
    assert v.estimator.reason == "the vehicle has rebooted"
    v.t_us = 0
    v.go(6.0)
    assert v.estimator.frame is frame
    assert v.estimator.running
    assert v.estimator.reset_counter == 1


def test_a_turned_imu_is_turned_back() -> None:
    turned = Vehicle(Settings(imu=ImuSettings(rotation=(math.pi, 0.0, 0.0))))
    C = quat_to_dcm(euler_to_quat(math.pi, 0.0, 0.0))
    feed = turned.estimator.feed_imu

    def upside_down(table: ImuTable) -> None:
        feed(ImuTable(table.t_us, table.accel_b @ C, table.gyro_b @ C))

    turned.estimator.feed_imu = upside_down  # type: ignore[method-assign]
    turned.go(6.0)
    s = turned.solution
    assert_allclose([s.roll, s.pitch, s.yaw], ATTITUDE, atol=0.02)


@pytest.mark.parametrize("used", [True, False])
def test_standing_teaches_the_gyro_bias(used: bool) -> None:
    v = Vehicle(Settings(zero_velocity=ZeroVelocitySettings(enabled=used)))
    v.go(6.0)
    v.gyro_bias = np.array([0.0, 0.0, 0.01])
    v.go(8.0, headings=False)
    # gravity does not show what turns about the vertical
    assert (np.linalg.norm(v.solution.b_g - v.gyro_bias) < 5e-3) == used
    v.estimator.finish()
    assert ("zero_rate" in v.estimator.statistics) == used
    if used:
        assert v.estimator.statistics["zero_rate"].accepted > 20


def test_yaw_without_heading_grows_uncertain_and_says_so() -> None:
    # as in a steady hover: on the ground zero rate holds the yaw
    v = Vehicle(Settings(zero_velocity=ZeroVelocitySettings(enabled=False)))
    v.go(6.0)
    v.go(60.0, headings=False)
    assert v.estimator.health is Health.RUNNING
    assert v.estimator.reason.startswith("yaw not observable")


def test_an_estimate_that_is_not_finite_is_given_up() -> None:
    v = Vehicle()
    v.go(6.0)
    v.estimator.feed_imu(
        ImuTable(np.array([v.t_us + 10_000]), np.full((1, 3), np.nan), np.zeros((1, 3)))
    )
    assert not v.estimator.running
    assert v.estimator.health is Health.DIVERGED


def test_habits_are_used_where_they_are_switched_on() -> None:
    v = Vehicle()
    v.go(5.0)
    assert not {"gravity_tilt", "nonholonomic"} & set(v.estimator.statistics)
    v = Vehicle(
        Settings(
            gravity_tilt=GravityTiltSettings(enabled=True),
            nonholonomic=NonholonomicSettings(enabled=True, lever_arm=(-1.0, 0.0, 0.3)),
        )
    )
    v.go(5.0)
    assert v.estimator.health is Health.RUNNING
    for name in ("gravity_tilt", "nonholonomic"):
        statistics = v.estimator.statistics[name]
        assert statistics.accepted > 5
        assert not statistics.rejected


@pytest.mark.parametrize("detector", ["start", "shoe", "ared", "amvd", "mag", "gnss_speed"])
def test_standing_after_a_motion_is_found_by_every_detector_but_start(detector: str) -> None:
    noises = {"sigma_accel": 0.05, "sigma_gyro": 0.005, "threshold": 15.0}
    v = Vehicle(Settings(zero_velocity=ZeroVelocitySettings(detector=detector, **noises)))
    v.go(6.0)
    v.gyro_bias = np.array([0.0, 0.0, 0.1])  # it turns a little
    v.go(1.0, v_l=(1.0, 0.0, 0.0))
    v.gyro_bias = np.zeros(3)
    v.go(1.0)
    before = v.estimator.statistics["zero_velocity"].accepted
    v.go(3.0)
    after = v.estimator.statistics["zero_velocity"].accepted
    assert after - before == 0 if detector == "start" else after - before > 30
    assert v.estimator.running


def test_what_it_tells_beside_its_solution() -> None:
    v = Vehicle()
    assert v.estimator.standing is None
    assert v.estimator.yaw_from_motion() is None
    assert len(v.estimator.imu_after(-1)[0]) == 0
    v.go(6.0)
    assert v.estimator.standing is True
    assert v.estimator.yaw_from_motion() is None, "nothing has moved"
    times, rows = v.estimator.imu_after(v.t_us - 50_000)
    assert times.tolist() == [v.t_us - 10_000 * k for k in (4, 3, 2, 1, 0)]
    assert rows.shape == (5, 6)
    v.gyro_bias[:] = 1.0  # as good as a turn
    v.go(1.0)
    state = v.estimator._line.state
    assert state is not None
    state.x[3:6] = 0.0
    assert v.estimator.standing is None, "it moved, but not away"
    state.x[3] = 5.0
    assert v.estimator.standing is False
