"""The Euler-angle model: its mechanization against the strapdown one, its dynamics against differences."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.filters import euler_model as model
from mavins.filters.van_loan import AFTER, BEFORE, E_INV, STACK, A, B, C, E
from mavins.nav.ins import Vector
from mavins.nav.layout import X_SIZE
from mavins.nav.so3 import euler_jacobian, euler_to_quat, quat_exp, quat_mul, quat_to_dcm
from mavins.types import FloatArray

SEEDS = range(5)
STILL: Vector = (0.0, 0.0, 0.0)


def random_motion(seed: int) -> tuple[Vector, Vector, Vector]:
    """(angles, w, f)."""
    rng = np.random.default_rng(seed)
    a = (float(rng.uniform(-3, 3)), float(rng.uniform(-1.3, 1.3)), float(rng.uniform(-3, 3)))
    return a, vector(rng.normal(size=3)), vector(rng.normal(size=3) * 5.0)


def vector(v: FloatArray) -> Vector:
    return float(v[0]), float(v[1]), float(v[2])


def quaternion(angles: Vector) -> FloatArray:
    return euler_to_quat(*angles)


def difference(function: Callable[[Vector], Vector | FloatArray], at: Vector) -> FloatArray:
    """d function / d at by central differences."""
    h, columns = 1e-6, []
    for i in range(3):
        step = np.zeros(3)
        step[i] = h
        ends = [np.asarray(function(vector(np.array(at) + s * step))) for s in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2 * h))
    return np.column_stack(columns)


@pytest.mark.parametrize("seed", SEEDS)
def test_matrices_are_those_of_the_angles(seed: int) -> None:
    angles, _, _ = random_motion(seed)
    M = np.empty((STACK, 3, 3))
    a = model.trig(angles)
    model.write_dcm(M, C, a)
    model.write_kinematics(M, E, a)
    model.write_inverse_kinematics(M, E_INV, a)
    assert_allclose(M[C], quat_to_dcm(quaternion(angles)), atol=1e-15)
    assert_allclose(M[E], euler_jacobian(angles[0], angles[1]), atol=1e-14)
    assert_allclose(M[E] @ M[E_INV], np.eye(3), atol=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_dynamics_are_the_derivatives(seed: int) -> None:
    angles, w, f = random_motion(seed)
    M = np.empty((STACK, 3, 3))
    a = model.trig(angles)
    model.linearize(M, a, a, a, w, f)

    def rates(a: Vector) -> Vector:
        return model.angle_rates(a[0], a[1], w)

    def force(a: Vector) -> FloatArray:
        turned: FloatArray = quat_to_dcm(quaternion(a)) @ np.array(f)
        return turned

    kinematics = euler_jacobian(angles[0], angles[1])
    in_angles = difference(rates, angles)
    assert_allclose(M[A], np.linalg.solve(kinematics, in_angles @ kinematics), atol=1e-6)
    assert_allclose(M[B], difference(force, angles) @ kinematics, atol=1e-7)
    assert_allclose(M[BEFORE], np.eye(3), atol=1e-14)
    assert_allclose(M[AFTER], np.eye(3), atol=1e-14)


def test_the_ways_into_and_out_of_an_interval() -> None:
    start, at, end = (0.1, 0.2, 0.3), (0.4, -0.5, 1.0), (-0.2, 0.6, 2.0)
    M = np.empty((STACK, 3, 3))
    model.linearize(M, model.trig(start), model.trig(at), model.trig(end), STILL, STILL)
    kinematics = [euler_jacobian(a[0], a[1]) for a in (start, at, end)]
    assert_allclose(M[BEFORE], np.linalg.solve(kinematics[1], kinematics[0]), atol=1e-14)
    assert_allclose(M[AFTER], np.linalg.solve(kinematics[2], kinematics[1]), atol=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_angles_turn_as_the_quaternion_does(seed: int) -> None:
    angles, w, _ = random_motion(seed)
    dt = 0.02
    middle, end = model.integrate_angles(angles, w, w, dt)
    for got, part in ((middle, 0.5 * dt), (end, dt)):
        expected = quat_mul(quaternion(angles), quat_exp(np.array(w) * part))
        assert abs(abs(quaternion(got) @ expected) - 1.0) < 1e-11
        turn = quat_to_dcm(quaternion(got)) - quat_to_dcm(expected)
        assert np.abs(turn).max() < 2e-6


def test_fourth_order() -> None:
    """Half the interval, a sixteenth of the error: a rate that changes is followed along its line."""
    start, w0, w1 = (0.3, 0.7, -2.0), (1.0, -2.0, 0.5), (-1.0, 1.5, 2.0)
    reference = start
    for k in range(1024):
        at = [vector(np.array(w0) + (k + i) / 1024 * np.subtract(w1, w0)) for i in (0, 1)]
        reference = model.integrate_angles(reference, at[0], at[1], 0.1 / 1024)[1]
    errors = []
    for pieces in (1, 2, 4):
        angles = start
        for k in range(pieces):
            at = [vector(np.array(w0) + (k + i) / pieces * np.subtract(w1, w0)) for i in (0, 1)]
            angles = model.integrate_angles(angles, at[0], at[1], 0.1 / pieces)[1]
        errors.append(np.abs(np.subtract(angles, reference)).max())
    assert errors[0] / errors[1] > 10
    assert errors[1] / errors[2] > 10


def test_velocity_and_position_by_simpson() -> None:
    """An acceleration quadratic in time gives the velocity of its integral; one linear in time the position's, too."""
    dt = 2.0
    x = np.zeros(X_SIZE)
    x[3:6] = [1.0, 2.0, 3.0]

    def at(t: float) -> Vector:
        return (t, 3.0, t * t)

    model.move(x, at(0.0), at(1.0), at(2.0), dt)
    assert_allclose(x[3:6], [1.0 + 2.0, 2.0 + 6.0, 3.0 + 8.0 / 3.0])
    assert_allclose(x[0:2], [2.0 + 8.0 / 6.0, 4.0 + 6.0])


def test_where_the_angles_are_singular() -> None:
    limit = math.radians(87.0)
    for pitch in (limit + 1e-9, -limit - 1e-9, math.pi / 2, 2.0, math.nan):
        assert model.is_singular(pitch)
    for pitch in (limit - 1e-9, -limit + 1e-9, 0.0):
        assert not model.is_singular(pitch)
