"""The yaw from motion through the estimator: a start without a heading, and a wrong heading that is set right."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
import pytest

from mavins.config import load as load_config
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.fusion import Event
from mavins.estimator.motion import MotionHeading
from mavins.estimator.settings import Settings
from mavins.evaluation.errors import interpolate_truth
from mavins.evaluation.tape import Tape
from mavins.examples.scenarios import flight
from mavins.logs.truth import Truth
from mavins.nav.so3 import quat_to_euler
from mavins.types import GnssFix, Health, ImuTable
from sitl.scenario import load

pytestmark = [pytest.mark.slow, pytest.mark.jit]
FIRST_PUSH_S = 17.0
"""Until about here the vehicle stands, climbs and hovers."""


@functools.cache
def flown() -> tuple[Tape, Truth]:
    scenario = load("quad_mission")
    scenario = dataclasses.replace(
        scenario,
        imu=dataclasses.replace(scenario.imu, rate=100),
        heading=dataclasses.replace(scenario.heading, rate=10),
    )
    return flight(load_config(None, {}), scenario, 3, 45.0)


def play(
    filter_name: str = "eskf",
    offset: float | None = None,
    sizes: Sequence[int] = (10**9,),
    settings: Settings | None = None,
) -> tuple[list[tuple[float, float, float]], Estimator, list[Event]]:
    """(time in s, yaw error, yaw sigma) at each fix with an estimate; headings are wrong by `offset`, or left out."""
    tape, truth = flown()
    decisions: list[Event] = []
    estimator = Estimator(
        settings or tape.settings, filter_name, Outputs(-1, None, decisions.append)
    )
    errors = []
    k = 0
    for name, what in tape.feeds:
        if isinstance(what, ImuTable):
            start = 0
            while start < len(what):
                end = start + sizes[k % len(sizes)]
                k += 1
                rows = slice(start, end)
                estimator.feed_imu(ImuTable(what.t_us[rows], what.accel_b[rows], what.gyro_b[rows]))
                start = end
            continue
        if name == "feed_heading":
            if offset is None:
                continue
            what = dataclasses.replace(what, yaw=math.remainder(what.yaw + offset, 2.0 * math.pi))
        getattr(estimator, name)(what)
        solution = estimator.solution()
        if name == "feed_gnss" and solution is not None:
            q_lb = interpolate_truth(np.array([solution.t_us]), *truth.columns())[2][0]
            error = math.remainder(solution.yaw - quat_to_euler(q_lb)[2], 2.0 * math.pi)
            errors.append((solution.t_us * 1e-6, error, solution.sd_euler[2]))
    estimator.finish()
    return errors, estimator, decisions


@pytest.mark.parametrize("filter_name", ["eskf", "iekf"])
def test_without_a_heading_motion_starts_it(filter_name: str) -> None:
    errors, estimator, _ = play(filter_name)
    start_s, error, sigma = errors[0]
    assert FIRST_PUSH_S < start_s < FIRST_PUSH_S + 4.0
    assert abs(error) < math.radians(10.0)
    assert abs(error) < 3.0 * sigma
    assert all(abs(e) < math.radians(3.0) for t, e, _ in errors if t > start_s + 20.0)
    assert estimator.reset_counter == 0
    assert estimator.health is Health.RUNNING


def test_until_then_it_says_what_it_waits_for() -> None:
    tape, _ = flown()
    off = dataclasses.replace(
        tape.settings, heading=dataclasses.replace(tape.settings.heading, from_motion=False)
    )
    errors, estimator, _ = play(settings=off)
    assert not errors
    assert estimator.reason == "no heading source"


def test_rows_at_a_time_change_nothing() -> None:
    whole, _, _ = play(offset=math.pi / 2.0)
    for sizes in ((1,), (3, 1, 7)):
        assert play(offset=math.pi / 2.0, sizes=sizes)[0] == whole


def test_a_wrong_heading_is_set_right_in_flight() -> None:
    errors, estimator, decisions = play(offset=math.pi / 2.0)
    assert abs(errors[0][1]) > math.radians(80.0)
    assert [e.reason for e in decisions if e.reason == "yaw reset"] == ["yaw reset"]
    assert estimator.reset_counter == 1
    assert all(abs(e) < math.radians(10.0) for t, e, _ in errors if t > FIRST_PUSH_S + 5.0)
    # the source that was wrong goes on, and is refused
    late = [
        e.accepted
        for e in decisions
        if e.measurement.aiding == "heading" and e.measurement.t_us > 25_000_000
    ]
    assert len(late) > 100
    assert not any(late)


def test_a_right_heading_is_left_alone() -> None:
    errors, estimator, _ = play(offset=0.0)
    assert estimator.reset_counter == 0
    assert max(abs(e) for _, e, _ in errors) < math.radians(6.0)


def test_running_behind_makes_no_difference() -> None:
    """Velocities that wait for their IMU rows to grow old leave what those leave that are fused at once."""
    t_us = np.arange(0, 12_000_000, 10_000)
    push = 2.0 * np.sin(t_us * 1e-6)
    imu = np.column_stack([0.05 * push, *np.zeros((2, len(push))), push, 0 * push, 0 * push - 9.81])
    seen = []
    for asked in (True, False):
        motion, buffer, done = MotionHeading(Settings()), ImuBuffer(), 0
        behind = 0
        for now_us in range(200_000, 12_000_000, 200_000):
            end = int(np.searchsorted(t_us, now_us, "right"))
            buffer.append(t_us[done:end], imu[done:end])
            done = end
            v = 2.0 - 2.0 * math.cos(now_us * 1e-6)
            motion.see_fix(GnssFix(now_us, 0.8, 0.1, 0.0, (v, 0.0, 0.0), 3), now_us - 3_000, 0.1)
            motion.step(buffer, now_us, asked)
            behind += motion.at(buffer, now_us - 150_000) is not None
        motion.step(buffer, now_us, True)
        found = motion.at(buffer, now_us)
        assert found is not None
        seen.append((behind, found))
    assert seen[0][0] < seen[1][0]
    for at_once, waited in zip(seen[0][1], seen[1][1], strict=True):
        np.testing.assert_array_equal(at_once, waited)
