"""The Gramian against hand-made cases, and what is known of INS/GNSS: which motion shows which state."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading
from mavins.estimator.settings import Settings
from mavins.evaluation.course import Course, label_of
from mavins.evaluation.observability import (
    Analysis,
    analyse,
    carry,
    information,
    names_of,
    posterior,
    prior_sigmas,
    spectrum,
)
from mavins.evaluation.observability_table import as_dict, direction, table_lines
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.ins import increments_from_rates, mechanize
from mavins.nav.layout import BLOCKS, CORE, X_Q, X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import quat_exp, quat_to_dcm
from mavins.types import FloatArray, GnssFix, HeadingFix, Origin

ORIGIN = Origin(math.radians(47.0), math.radians(8.0), 400.0)
STILL = dataclasses.replace(TangentFrame.at(ORIGIN), w_ie_n=np.zeros(3))
"""An Earth that does not turn: nothing but motion can show a yaw."""
ALL = Layout.of((*CORE, "l_b", "tau"))
EVERY = Layout.of(BLOCKS)
NAMES = names_of(ALL)
PRIOR = prior_sigmas(Settings())
DT = 0.02
ZERO = np.zeros(3)
NORTH = np.array([1.0, 0.0, 0.0])


def course_of(
    seconds: float, a_n: FloatArray, v_n: FloatArray, turn: float = 0.0, since: float = 0.0
) -> Course:
    """A level course at `v_n`, from `since` on with a constant acceleration and turn about the vertical."""
    t = np.arange(round(seconds / DT) + 1) * DT
    x, u = np.zeros((len(t), X_SIZE)), np.zeros((len(t), 6))
    s = np.maximum(t - since, 0.0)
    x[:, 0:3] = np.outer(t, v_n) + 0.5 * np.outer(s**2, a_n)
    x[:, 3:6] = v_n + np.outer(s, a_n)
    u[:, 2] = np.where(t >= since, turn, 0.0)
    for k in range(len(t)):
        x[k, X_Q] = quat_exp(np.array([0.0, 0.0, turn * s[k]]))
        push_n = a_n if t[k] >= since else ZERO
        g = gravity_n(x[k, 0:3], STILL.r0_e, STILL.C_ne)
        u[k, 3:6] = quat_to_dcm(x[k, X_Q]).T @ (push_n - g)
    t_us = np.round(t * 1e6).astype(np.int64)
    measurements = [m for k in range(0, len(t), 10) for m in measured(int(t_us[k]), x[k])]
    return Course(STILL, t_us, x, u, tuple(measurements))


def measured(t_us: int, x: FloatArray) -> list[Measurement]:
    fix = GnssFix(t_us, *STILL.to_lla(x[0:3]).tolist(), (0.0, 0.0, 0.0), 3)
    velocity = gnss_velocity.measure(fix, t_us, STILL, 0.1, 5.0)
    assert velocity is not None
    return [
        gnss_position.measure(fix, t_us, STILL, 0.5, 0.8, 5.0),
        velocity,
        heading.measure(HeadingFix(t_us, 0.0), t_us, STILL, 0.05, 5.0),
    ]


def observed(course: Course, *, compass: bool) -> Analysis:
    return analyse(course if compass else course.without(("heading",)), ALL, PRIOR, 10.0)


def ratio(analysis: Analysis, state: str) -> float:
    return float(analysis.ratios[-1, NAMES.index(state)])


def test_the_gramian_of_a_line() -> None:
    """Place and speed of a point whose place is measured at 0, 1 and 2 s: the sums of least squares."""
    H, R = np.array([[1.0, 0.0]]), np.array([[4.0]])
    gramian = sum(information(H, R, np.array([[1.0, t], [0.0, 1.0]])) for t in (0.0, 1.0, 2.0))
    assert_allclose(gramian, np.array([[3.0, 3.0], [3.0, 5.0]]) / 4.0)
    prior = np.array([2.0, 10.0])
    values, weakest = spectrum(gramian, prior)
    assert_allclose(values.sum(), 3.0 + 125.0)  # the trace of S O S
    assert_allclose(values.prod(), 6.0 / 16.0 * 400.0)  # its determinant
    scaled = gramian * np.outer(prior, prior)
    assert_allclose(scaled @ weakest, values[-1] * weakest, atol=1e-12)
    P = np.linalg.inv(np.diag(prior**-2.0) + gramian)
    assert_allclose(posterior(gramian, prior), np.sqrt(np.diagonal(P)) / prior)


def test_the_transition_against_finite_differences() -> None:
    course = course_of(2.0, np.array([1.0, 0.5, -0.3]), np.array([3.0, -2.0, 0.5]), turn=0.4)
    Phi = np.eye(EVERY.size)
    frame = course.frame
    last = len(course.t_us) - 1
    carry(Phi, course.t_us, course.x, course.u, 0, last, True, frame.r0_e, frame.C_ne, frame.w_ie_n)

    def flown(d: FloatArray) -> FloatArray:
        x = course.x[0].copy()
        boxplus(x, d, EVERY.columns)
        for k in range(last):
            w0, f0 = course.u[k, :3] - x[10:13], course.u[k, 3:] - x[13:16]
            w1, f1 = course.u[k + 1, :3] - x[10:13], course.u[k + 1, 3:] - x[13:16]
            readings = [tuple(v.tolist()) for v in (w0, f0, w1, f1)]
            phi, dv = increments_from_rates(*readings, DT)
            mechanize(x, phi, dv, DT, frame.r0_e, frame.C_ne, frame.w_ie_n, np.empty((3, 3)))
        return x

    for i in range(EVERY.size):
        d = np.zeros(EVERY.size)
        d[i] = 1e-4
        column = boxminus(flown(d), flown(-d), EVERY.columns) / 2e-4
        assert_allclose(Phi[:, i], column, atol=0.01, rtol=2e-3, err_msg=names_of(EVERY)[i])


def test_at_rest_without_a_heading_the_yaw_is_not_seen() -> None:
    rest = course_of(10.0, ZERO, ZERO)
    without = observed(rest, compass=False)
    assert without.segments[0].label == "at rest"
    assert ratio(without, "theta_b.z") == pytest.approx(1.0, abs=1e-9)
    assert ratio(without, "b_g.z") == pytest.approx(1.0, abs=1e-9)
    assert without.visible_us[NAMES.index("theta_b.z")] == -1
    assert math.isinf(without.segments[0].condition)
    compass = observed(rest, compass=True)
    assert ratio(compass, "theta_b.z") < 0.1
    assert ratio(compass, "b_g.z") < 0.5


def test_a_change_of_acceleration_shows_the_yaw() -> None:
    """A constant one could as well be a tilt: it takes a change, as from segment to segment."""
    changing = observed(course_of(10.0, 2.0 * NORTH, ZERO, since=5.0), compass=False)
    assert changing.segments[0].label == "accelerating"
    constant = observed(course_of(10.0, 2.0 * NORTH, ZERO), compass=False)
    straight = observed(course_of(10.0, ZERO, 5.0 * NORTH), compass=False)
    assert straight.segments[0].label == "straight"
    assert ratio(changing, "theta_b.z") < 0.5
    assert ratio(changing, "theta_b.z") < 0.6 * ratio(constant, "theta_b.z")
    assert ratio(straight, "theta_b.z") == pytest.approx(1.0, abs=1e-4)


def test_turning_shows_the_lever_arm_and_parts_tilt_from_accelerometer_bias() -> None:
    straight = observed(course_of(20.0, ZERO, 5.0 * NORTH), compass=True)
    turning = observed(course_of(20.0, ZERO, 5.0 * NORTH, turn=0.5, since=10.0), compass=True)
    assert [s.label for s in turning.segments] == ["straight", "turning"]
    for state in ("l_b.x", "l_b.y", "b_a.x", "b_a.y"):
        assert ratio(turning, state) < 0.5 < 0.9 < ratio(straight, state)
    # what lies along the axis of the turn stays part of the position
    assert ratio(turning, "l_b.z") > 0.9


def test_only_a_changing_velocity_shows_the_delay() -> None:
    """At a constant velocity a delay is a shift of the place; a constant acceleration adds one of the velocity."""
    assert ratio(observed(course_of(10.0, ZERO, ZERO), compass=True), "tau") == 1.0
    straight = ratio(observed(course_of(10.0, ZERO, 5.0 * NORTH), compass=True), "tau")
    constant = ratio(observed(course_of(10.0, 2.0 * NORTH, ZERO), compass=True), "tau")
    changing = ratio(observed(course_of(10.0, 2.0 * NORTH, ZERO, since=5.0), compass=True), "tau")
    assert changing < 0.5 < min(straight, constant)


def test_segments_follow_each_other_and_information_only_grows() -> None:
    course = course_of(34.0, 0.1 * NORTH, NORTH)
    analysis = analyse(course, Layout.of(CORE), PRIOR, 10.0)
    bounds = [(s.start_us, s.end_us) for s in analysis.segments]
    assert bounds == [(0, 10_000_000), (10_000_000, 20_000_000), (20_000_000, 34_000_000)]
    assert len(analysis.states) == 15
    assert np.all(np.diff(analysis.ratios, axis=0) < 1e-9)
    one = analyse(course, Layout.of(CORE), PRIOR, 34.0)
    # cut into segments or whole, all data say the same
    assert_allclose(analysis.ratios[-1], one.ratios[-1], rtol=1e-6)
    assert analyse(course.until(10.0), Layout.of(CORE), PRIOR, 10.0).segments[0].end_us == 10**7


@pytest.mark.parametrize(
    ("a_n", "v_n", "turn", "label"),
    [
        (ZERO, ZERO, 0.0, "at rest"),
        (ZERO, ZERO, 0.3, "turning"),
        (ZERO, np.array([0.0, 0.0, -2.0]), 0.0, "climbing"),
        (NORTH, np.array([0.0, 0.0, -2.0]), 0.3, "accelerating, climbing, turning"),
    ],
)
def test_labels(a_n: FloatArray, v_n: FloatArray, turn: float, label: str) -> None:
    course = course_of(3.0, a_n, v_n, turn)
    assert label_of(course, 0, len(course.t_us) - 1) == label


def test_the_table_names_what_is_weak() -> None:
    analysis = observed(course_of(10.0, ZERO, ZERO), compass=False)
    text = "\n".join(table_lines(analysis))
    assert "at rest" in text
    (yaw,) = (line for line in text.splitlines() if line.startswith("theta_b.z"))
    assert "never" in yaw
    assert yaw.endswith("1.000")
    assert direction(np.array([0.1, -0.9, 0.42]), ("a", "b", "c")) == "b +0.90 c -0.42"
    found = as_dict(analysis)
    assert [s["name"] for s in found["states"]] == list(NAMES)
    assert found["states"][NAMES.index("theta_b.z")]["visible_s"] is None
    assert len(found["segments"][0]["singular_values"]) == 19
