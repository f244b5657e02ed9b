"""Laws of rotations for any rotation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mavins.nav import so3
from mavins.types import FloatArray

pytestmark = pytest.mark.jit


def vectors(longest: float) -> st.SearchStrategy[FloatArray]:
    """Vectors up to a length, small ones as likely as large ones."""
    unit = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
    size = st.one_of(st.floats(0.0, longest), st.floats(-12.0, 0.0).map(lambda e: 10.0**e))

    def scaled(pair: tuple[tuple[float, ...], float]) -> FloatArray:
        v = np.array(pair[0])
        n = float(np.linalg.norm(v))
        return v * (pair[1] / n) if n > 1e-3 else np.array([0.0, 0.0, pair[1]])

    return st.tuples(unit, size).map(scaled)


TURNS = vectors(math.pi - 1e-6)
ANY = vectors(20.0)
ANGLE = st.floats(-math.pi, math.pi)


@given(TURNS)
def test_logarithm_undoes_exponential(phi: FloatArray) -> None:
    assert_allclose(so3.quat_log(so3.quat_exp(phi)), phi, rtol=1e-9, atol=1e-15)


@given(ANY)
def test_exponential_is_a_rotation(phi: FloatArray) -> None:
    q = so3.quat_exp(phi)
    C = so3.quat_to_dcm(q)
    assert_allclose(q @ q, 1.0, atol=1e-14)
    assert_allclose(C @ C.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(C) == pytest.approx(1.0)
    assert np.linalg.norm(so3.quat_log(q)) <= math.pi + 1e-12


@given(ANY, ANY)
def test_matrices_multiply_as_quaternions_do(a: FloatArray, b: FloatArray) -> None:
    p, q = so3.quat_exp(a), so3.quat_exp(b)
    expected = so3.quat_to_dcm(p) @ so3.quat_to_dcm(q)
    assert_allclose(so3.quat_to_dcm(so3.quat_mul(p, q)), expected, atol=1e-14)


@given(ANY)
def test_a_matrix_knows_its_quaternion(phi: FloatArray) -> None:
    C = so3.quat_to_dcm(so3.quat_exp(phi))
    q = so3.dcm_to_quat(C)
    assert q[0] >= 0.0
    assert_allclose(so3.quat_to_dcm(q), C, atol=1e-14)


@given(ANGLE, st.floats(-math.pi / 2, math.pi / 2), ANGLE)
def test_euler_angles_name_the_rotation(roll: float, pitch: float, yaw: float) -> None:
    q = so3.euler_to_quat(roll, pitch, yaw)
    again = so3.euler_to_quat(*so3.quat_to_euler(q))
    # straight up or down the angles are not unique and less is known of them
    tolerance = 1e-13 if abs(pitch) < 1.5 else 1e-4
    assert_allclose(so3.quat_to_dcm(again), so3.quat_to_dcm(q), atol=tolerance)


@given(vectors(3.0), vectors(1e-5))
def test_right_jacobian_to_first_order(phi: FloatArray, d: FloatArray) -> None:
    expected = so3.quat_mul(so3.quat_exp(phi), so3.quat_exp(so3.right_jacobian(phi) @ d))
    got = so3.quat_exp(phi + d)
    assert_allclose(got, expected, atol=1e-15 + float(d @ d))


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles(angle: float) -> None:
    wrapped = so3.wrap_pi(angle)
    assert -math.pi < wrapped <= math.pi
    turns = (angle - wrapped) / (2 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-11)
