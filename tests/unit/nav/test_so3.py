"""Rotations against scipy's, and their Jacobians against central differences."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from mavins.nav import so3
from mavins.types import FloatArray

RNG = np.random.default_rng(11)
VECTORS = [
    np.zeros(3),
    np.array([1e-9, -2e-9, 5e-10]),
    np.array([3e-5, 4e-5, -5e-5]),
    np.array([1e-4, 0.0, 1e-5]),
    np.array([0.02, -0.01, 0.02]),
    np.array([0.0, 0.0, math.pi - 1e-9]),
    *RNG.uniform(-1.7, 1.7, (12, 3)),
]
ANGLES = [*RNG.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (12, 3)), np.array([0.2, -1.55, 3.0])]


def scipy_of(q: FloatArray) -> Rotation:
    return Rotation.from_quat(q[[1, 2, 3, 0]])


def differences(f: Callable[[FloatArray], FloatArray], n: int = 3, h: float = 1e-6) -> FloatArray:
    return np.column_stack([(f(h * e) - f(-h * e)) / (2 * h) for e in np.eye(n)])


@pytest.mark.parametrize("phi", VECTORS)
def test_exponential_and_its_matrix_are_scipy_s(phi: FloatArray) -> None:
    q = so3.quat_exp(phi)
    expected = Rotation.from_rotvec(phi).as_matrix()
    assert_allclose(np.linalg.norm(q), 1.0, atol=1e-15)
    assert_allclose(so3.quat_to_dcm(q), expected, atol=1e-15)


@pytest.mark.parametrize("phi", VECTORS)
def test_logarithm_undoes_the_exponential(phi: FloatArray) -> None:
    assert_allclose(so3.quat_log(so3.quat_exp(phi)), phi, rtol=1e-14, atol=1e-16)
    assert_allclose(so3.quat_log(-so3.quat_exp(phi)), phi, rtol=1e-14, atol=1e-16)


def test_product_turns_by_the_right_factor_first() -> None:
    p, q = so3.quat_exp(VECTORS[-1]), so3.quat_exp(VECTORS[-2])
    expected = (scipy_of(p) * scipy_of(q)).as_matrix()
    assert_allclose(so3.quat_to_dcm(so3.quat_mul(p, q)), expected, atol=1e-15)
    assert_allclose(so3.quat_mul(p, so3.quat_conj(p)), [1, 0, 0, 0], atol=1e-15)


def test_skew_is_the_cross_product() -> None:
    a, b = VECTORS[-1], VECTORS[-2]
    assert_allclose(so3.skew(a) @ b, np.cross(a, b), atol=1e-15)
    assert_allclose(so3.cross(a, b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("phi", [*VECTORS[:5], *VECTORS[6:], *(math.pi * np.eye(3))])
def test_every_branch_of_the_way_back_from_a_matrix(phi: FloatArray) -> None:
    q = so3.quat_normalize(so3.quat_exp(phi))
    back = so3.dcm_to_quat(so3.quat_to_dcm(q))
    assert back[0] >= 0.0
    assert_allclose(so3.quat_to_dcm(back), so3.quat_to_dcm(q), atol=4e-15)


@pytest.mark.parametrize("euler", ANGLES)
def test_euler_angles_are_yaw_pitch_roll(euler: FloatArray) -> None:
    q = so3.euler_to_quat(*euler)
    expected = Rotation.from_euler("ZYX", euler[::-1])
    assert_allclose(so3.quat_to_dcm(q), expected.as_matrix(), atol=1e-15)
    assert_allclose(so3.quat_to_euler(q), euler, atol=2e-14)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_pitch_at_its_end_stays_finite(pitch: float) -> None:
    q = so3.euler_to_quat(0.3, pitch, 0.1)
    assert np.all(np.isfinite(so3.quat_to_euler(q)))
    assert np.all(np.isfinite(so3.euler_jacobian(0.3, pitch)))


@pytest.mark.parametrize("euler", ANGLES[:-1])
def test_euler_jacobian(euler: FloatArray) -> None:
    q = so3.euler_to_quat(*euler)

    def change(theta: FloatArray) -> FloatArray:
        moved = so3.quat_to_euler(so3.quat_mul(q, so3.quat_exp(theta)))
        return np.array([so3.wrap_pi(a) for a in moved - euler])

    assert_allclose(so3.euler_jacobian(euler[0], euler[1]), differences(change), atol=2e-7)


@pytest.mark.parametrize("phi", [*VECTORS[:5], *VECTORS[6:]])
def test_right_jacobian(phi: FloatArray) -> None:
    inverse = so3.quat_conj(so3.quat_exp(phi))

    def change(d: FloatArray) -> FloatArray:
        return so3.quat_log(so3.quat_mul(inverse, so3.quat_exp(phi + d)))

    J = so3.right_jacobian(phi)
    assert_allclose(J, differences(change), atol=1e-9)
    assert_allclose(so3.right_jacobian_inv(phi) @ J, np.eye(3), atol=1e-12)


def test_right_jacobian_has_no_step_where_the_series_ends() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    for f in (so3.right_jacobian, so3.right_jacobian_inv, so3.quat_exp):
        for angle in (1e-3, math.sqrt(so3.SMALL)):
            below, above = f(axis * angle * (1 - 1e-9)), f(axis * angle * (1 + 1e-9))
            assert_allclose(below, above, atol=2e-11)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [
        (math.pi, math.pi),
        (-math.pi, math.pi),
        (3 * math.pi, math.pi),
        (-0.5, -0.5),
        (7.0, 7.0 - 2 * math.pi),
    ],
)
def test_wrapped_angles_lie_in_the_half_open_circle(angle: float, wrapped: float) -> None:
    assert so3.wrap_pi(angle) == pytest.approx(wrapped, abs=1e-12)
