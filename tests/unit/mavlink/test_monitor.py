"""The integrity monitor: what differs, for how long, and what is said of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from mavins.mavlink.autopilot_settings import MonitorSettings
from mavins.mavlink.codec import Attitude, GlobalPosition, LocalPosition
from mavins.mavlink.monitor import LOOK_US, Monitor
from mavins.mavlink.track import REACH_US, Instant, Track, tilt_and_yaw
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import euler_to_quat, quat_exp, quat_mul, quat_to_euler
from mavins.types import NavSolution, Origin

PX4, ARDUPILOT, GENERIC = 12, 3, 0
ATTITUDE, LOCAL, GLOBAL = 30, 32, 33
FRAME = TangentFrame.at(Origin(math.radians(47.0), math.radians(8.0), 400.0))
SIGMA = 0.1


class Flight:
    """An estimator whose vehicle flies a circle: 10 m/s, 0.5 rad/s, banked; `t_us` is set by the test."""

    def __init__(self, make: Callable[..., NavSolution]) -> None:
        self._make = make
        self.t_us: int | None = 10_000_000
        self.frame: TangentFrame | None = FRAME
        self.running = True
        self.resets = 0
        self.motion: float | None = None

    def yaw_from_motion(self) -> tuple[float, float] | None:
        s = self.solution()
        return None if self.motion is None or s is None else (s.yaw + self.motion, 0.05)

    def solution(self) -> NavSolution | None:
        return self.at(self.t_us) if self.running and self.t_us is not None else None

    def at(self, t_us: int) -> NavSolution:
        angle = 0.5e-6 * t_us
        p_n = np.array([20.0 * math.sin(angle), -20.0 * math.cos(angle), -50.0])
        v_n = np.array([10.0 * math.cos(angle), 10.0 * math.sin(angle), 0.0])
        q = euler_to_quat(0.4, 0.0, angle)
        lat, lon, alt = FRAME.to_lla(p_n)
        c_ln = FRAME.local_level(lat, lon)
        roll, pitch, yaw = quat_to_euler(q).tolist()
        w_b = 0.5 * np.array([0.0, math.sin(0.4), math.cos(0.4)])
        return dataclasses.replace(
            self._make(t_us, resets=self.resets),
            lat=lat, lon=lon, alt=alt, p_n=p_n, v_n=v_n, v_l=c_ln @ v_n, q_nb=q, q_lb=q,
            roll=roll, pitch=pitch, yaw=yaw, w_b=w_b, P=np.eye(15) * SIGMA**2,
        )  # fmt: skip

    def attitude(self, t_us: int, yaw: float = 0.0, roll: float = 0.0) -> Attitude:
        s = self.at(t_us)
        return Attitude(t_us, s.roll + roll, s.pitch, s.yaw + yaw, (0.0, 0.0, 0.0))

    def position(self, t_us: int, north: float = 0.0, up: float = 0.0) -> GlobalPosition:
        s = self.at(t_us)
        lat, lon, alt = FRAME.to_lla(s.p_n + np.array([north, 0.0, -up]))
        v = tuple(s.v_l.tolist())
        return GlobalPosition(t_us, lat, lon, alt, 0.0, v, None)


@pytest.fixture
def flight(solution: Callable[..., NavSolution]) -> Flight:
    return Flight(solution)


def seconds(start: float, end: float) -> Iterator[int]:
    """Five instants a second, in us."""
    return iter(range(round(start * 1e6), round(end * 1e6), 200_000))


def limit_of(allowed: float, sigma: float) -> float:
    return allowed + 3.0 * sigma


def show(monitor: Monitor, flight: Flight, msgid: int, message: Any, late_us: int = 0) -> None:
    """A message of the vehicle's, which reaches us `late_us` behind the IMU sample of its instant."""
    flight.t_us = message.stamp_us + late_us
    if monitor.wants(msgid, message.stamp_us, PX4):
        monitor.see(msgid, message, message.stamp_us)


def test_an_autopilot_that_agrees_is_left_in_peace(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(), flight)
    for t_us in seconds(10.0, 30.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us))
        show(monitor, flight, GLOBAL, flight.position(t_us))
        v = flight.at(t_us).v_l.tolist()
        show(monitor, flight, LOCAL, LocalPosition(t_us, (1e4, 0.0, 9.0), (v[0], v[1], v[2])))
    summary = monitor.summary()
    assert summary is not None
    assert set(summary) == {"position", "height", "velocity", "tilt", "yaw"}
    assert all(item["worst_ratio"] < 1e-3 and item["looks"] >= 100 for item in summary.values())
    assert not monitor.texts()
    assert not monitor.warning


def test_a_yaw_that_drifts_is_warned_of_in_time_and_forgiven_later(flight: Flight) -> None:
    settings = MonitorSettings(after=3.0, yaw_deg=10.0)
    monitor = Monitor(settings, flight)
    limit = limit_of(math.radians(10.0), SIGMA)
    said: list[tuple[float, str, bool]] = []

    def yaw_error(t: float) -> float:
        """Nothing for 10 s, then 4 deg a second for 20 s, then nothing."""
        return math.radians(4.0 * (t - 20.0)) if 20.0 <= t < 40.0 else 0.0

    for t_us in seconds(10.0, 60.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=yaw_error(t_us * 1e-6)))
        said += [(t_us * 1e-6, text, warn) for text, warn in monitor.texts()]
        assert monitor.warning == (len(said) == 1)
    (begin, text, is_warning), (end, text_after, is_warning_after) = said
    over = 20.0 + math.degrees(limit) / 4.0
    assert over + 3.0 <= begin <= over + 3.4
    assert 43.0 <= end <= 43.4
    assert is_warning
    assert not is_warning_after
    apart = math.degrees(yaw_error(begin))
    assert text == f"mavins: autopilot yaw differs by {apart:.0f} deg (limit 27)"
    assert text_after == "mavins: autopilot yaw agrees again, 0 deg"
    summary = monitor.summary()
    assert summary is not None
    yaw = summary["yaw"]
    assert yaw["warnings"] == 1
    assert yaw["warned_s"] == pytest.approx(end - begin, abs=0.3)
    assert yaw["worst_difference"] == pytest.approx(math.radians(79.2), abs=0.01)
    assert summary["tilt"]["worst_ratio"] < 1e-3, "a turn about the vertical is no tilt"


def test_a_position_that_drifts(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(position=1.5), flight)
    said = []
    for t_us in seconds(10.0, 40.0):
        north = min(t_us * 1e-6 - 10.0, 5.0) if t_us < 25_000_000 else 0.0
        show(monitor, flight, GLOBAL, flight.position(t_us, north=north))
        said += [(t_us * 1e-6, text) for text, _ in monitor.texts()]
    limit = limit_of(1.5, SIGMA * math.sqrt(2.0))
    (begin, text), (end, _) = said
    assert 10.0 + limit + 3.0 <= begin <= 10.0 + limit + 3.4
    assert 28.0 <= end <= 28.4
    assert text.startswith("mavins: autopilot position differs by 5.0 m (limit 1.9)")


def test_height_and_roll_have_limits_of_their_own(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(), flight)
    for t_us in seconds(10.0, 15.0):
        show(monitor, flight, GLOBAL, flight.position(t_us, up=8.0))
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, roll=math.radians(60.0)))
    status = monitor.status()
    assert status is not None
    assert {name for name, item in status.items() if item.warning} == {"height", "tilt"}
    assert status["height"].difference == pytest.approx(8.0, abs=1e-3)
    assert status["tilt"].difference == pytest.approx(math.radians(60.0), abs=1e-6)
    assert status["tilt"].beyond == pytest.approx(4.8)


def test_what_lasts_shorter_is_not_said(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(after=3.0), flight)
    for t_us in seconds(10.0, 60.0):
        wrong = t_us % 5_000_000 < 2_800_000
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=2.0 * wrong))
    assert not monitor.texts()


def test_around_the_limit_a_warning_does_not_flicker(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(after=1.0), flight)
    limit = limit_of(math.radians(10.0), SIGMA)
    for t_us in seconds(10.0, 12.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=1.1 * limit))
    assert len(monitor.texts()) == 1
    for t_us in seconds(12.0, 30.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=0.9 * limit))
    assert not monitor.texts()
    assert monitor.warning


def test_a_silence_is_no_evidence(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(after=3.0), flight)
    for t_us in (10_000_000, 14_000_000, 18_000_000):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=1.0))
    assert not monitor.warning


def test_the_yaw_is_compared_the_short_way_round(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(), flight)
    for t_us in seconds(10.0, 30.0):  # more than a whole turn
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=2.0 * math.pi + 0.05))
    summary = monitor.summary()
    assert summary is not None
    assert summary["yaw"]["worst_difference"] == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize("late_us", [0, 60_000, 150_000])
def test_a_late_message_is_held_against_its_own_instant(flight: Flight, late_us: int) -> None:
    monitor = Monitor(MonitorSettings(), flight)
    for t_us in range(10_000_000, 20_000_000, 66_000):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us), late_us)
        show(monitor, flight, GLOBAL, flight.position(t_us), late_us)
    summary = monitor.summary()
    assert summary is not None
    assert summary["position"]["looks"] > 40
    assert summary["position"]["worst_difference"] < 0.1, "at 10 m/s, 150 ms are 1.5 m"
    assert summary["yaw"]["worst_difference"] < 0.005
    assert summary["velocity"]["worst_difference"] < 0.6


def test_five_looks_a_second_at_each_kind(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(), flight)
    looks = {ATTITUDE: 0, GLOBAL: 0}
    for t_us in range(10_000_000, 20_000_000, 4_000):
        for msgid, message in ((ATTITUDE, flight.attitude), (GLOBAL, flight.position)):
            if monitor.wants(msgid, t_us, PX4):
                looks[msgid] += 1
                flight.t_us = t_us
                monitor.see(msgid, message(t_us), t_us)
    assert looks[ATTITUDE] == looks[GLOBAL]
    assert looks[ATTITUDE] <= 10e6 / LOOK_US + 1
    assert not monitor.wants(105, 99_000_000, PX4)


@pytest.mark.parametrize(
    ("enabled", "autopilots"),
    [("auto", {PX4, ARDUPILOT}), (True, {PX4, ARDUPILOT, GENERIC, None}), (False, set())],
)
def test_who_is_watched(flight: Flight, enabled: Any, autopilots: set[int | None]) -> None:
    monitor = Monitor(MonitorSettings(enabled=enabled), flight)
    watched = {a for a in (PX4, ARDUPILOT, GENERIC, None) if monitor.wants(ATTITUDE, 1, a)}
    assert watched == autopilots


def test_without_an_estimate_nothing_is_claimed(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(after=1.0), flight)
    assert monitor.status() is None
    assert monitor.summary() is None
    for t_us in seconds(10.0, 12.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=1.0))
    assert monitor.warning
    monitor.texts()
    flight.running = False
    show(monitor, flight, ATTITUDE, flight.attitude(12_000_000, yaw=1.0))
    assert monitor.texts() == [("mavins: autopilot yaw is not compared", False)]
    assert not monitor.warning


def test_after_a_reboot_it_begins_anew(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(after=1.0), flight)
    for t_us in seconds(10.0, 12.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=1.0))
    assert monitor.warning
    for t_us in seconds(1.0, 3.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us))
    assert not monitor.warning
    for t_us in seconds(3.0, 5.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us, yaw=1.0))
    assert monitor.warning


def test_a_jump_of_our_own_estimate_is_not_interpolated(flight: Flight) -> None:
    track = Track(flight)
    assert track.remember()
    flight.t_us, flight.resets = 10_200_000, 1
    assert track.remember()
    assert track.at(10_100_000) is None
    assert track.at(10_200_000) is not None
    assert track.at(10_200_000 + REACH_US + 1) is None
    assert track.at(9_000_000) is None


def test_between_two_instants(flight: Flight) -> None:
    a, b, half = (Instant.of(flight.at(t), FRAME, None) for t in (0, 200_000, 100_000))
    found = a.between(b, 100_000)
    np.testing.assert_allclose(found.p_n, half.p_n, atol=0.03)
    np.testing.assert_allclose(found.v_l, half.v_l, atol=0.02)
    np.testing.assert_allclose(found.q_lb, half.q_lb, atol=1e-9)
    moved = a.moved(20_000)
    later = Instant.of(flight.at(20_000), FRAME, None)
    np.testing.assert_allclose(moved.q_lb, later.q_lb, atol=1e-9)
    np.testing.assert_allclose(moved.p_n, later.p_n, atol=2e-3)


@pytest.mark.parametrize("pitch", [0.0, 1.2, math.pi / 2])
def test_tilt_and_yaw_of_a_turn(pitch: float) -> None:
    q = euler_to_quat(0.3, pitch, -2.0)
    about_down = quat_mul(quat_exp(np.array([0.0, 0.0, -2.5])), q)
    assert tilt_and_yaw(about_down, q) == pytest.approx((0.0, -2.5), abs=1e-9)
    about_level = quat_mul(quat_exp(np.array([0.6, -0.8, 0.0]) * 0.7), q)
    assert tilt_and_yaw(about_level, q) == pytest.approx((0.7, 0.0), abs=1e-9)
    assert tilt_and_yaw(-about_level, q) == pytest.approx((0.7, 0.0), abs=1e-9)


def test_where_our_yaw_went_along_motion_tells(flight: Flight) -> None:
    monitor = Monitor(MonitorSettings(after=1.0), flight)
    flight.motion = -0.6  # the autopilot's yaw and ours agree, and both are off
    for t_us in seconds(10.0, 12.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us))
    status = monitor.status()
    assert status is not None
    assert status["yaw"].warning
    assert status["yaw"].difference == pytest.approx(0.6, abs=1e-6)
    assert status["yaw"].limit == pytest.approx(limit_of(math.radians(10.0), 0.05))
    flight.motion = None
    for t_us in seconds(12.0, 14.0):
        show(monitor, flight, ATTITUDE, flight.attitude(t_us))
    assert not monitor.warning
