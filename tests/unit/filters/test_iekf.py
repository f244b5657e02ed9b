"""The invariant filter against the group it is defined on, and its way out of a large heading error."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm, logm

from mavins.aiding import Measurement, gnss_position, gnss_velocity
from mavins.filters import Filter, FilterSettings, FilterState, ImuNoise, RowBlock, make
from mavins.filters.eskf import Eskf
from mavins.filters.iekf import Iekf, group_step
from mavins.filters.iterated import BLOCKS, turn_rows
from mavins.filters.settings import IteratedSettings
from mavins.nav import ins
from mavins.nav.earth import TangentFrame, gravity_n, write_gravity_gradient
from mavins.nav.layout import X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import (
    euler_to_quat,
    quat_log,
    quat_mul,
    quat_to_dcm,
    quat_to_euler,
    skew,
    wrap_pi,
)
from mavins.types import FloatArray, Origin
from sitl.scenario import load
from sitl.simulation import Measurements, simulate

FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
NOISE = ImuNoise(3e-4, 3e-3, 1e-5, 1e-4)
COLUMNS = Layout.of().columns
SEEDS = range(4)


def random_state(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    x = np.zeros(X_SIZE)
    x[:16] = rng.normal(size=16) * np.repeat([500.0, 10.0, 0.0, 0.02, 0.2], [3, 3, 4, 3, 3])
    x[6:10] = euler_to_quat(rng.uniform(-3, 3), rng.uniform(-1.2, 1.2), rng.uniform(-3, 3))
    return x


def element(x: FloatArray) -> FloatArray:
    """The state as an element (5, 5) of SE_2(3)."""
    chi = np.eye(5)
    chi[:3, :3], chi[:3, 3], chi[:3, 4] = quat_to_dcm(x[6:10]), x[3:6], x[:3]
    return chi


def wedge(xi: FloatArray) -> FloatArray:
    """The matrix (5, 5) in the algebra of xi = (rho, nu, phi)."""
    M = np.zeros((5, 5))
    M[:3, :3], M[:3, 3], M[:3, 4] = skew(xi[6:9]), xi[3:6], xi[:3]
    return M


def vee(M: FloatArray) -> FloatArray:
    return np.concatenate([M[:3, 4], M[:3, 3], [M[2, 1], M[0, 2], M[1, 0]]])


def adjoint(x: FloatArray) -> FloatArray:
    """Ad (9, 9): xi_right = Ad xi_left."""
    C = quat_to_dcm(x[6:10])
    A = np.kron(np.eye(3), C)
    A[:3, 6:], A[3:6, 6:] = skew(x[:3]) @ C, skew(x[3:6]) @ C
    return A


def small_adjoint(xi: FloatArray) -> FloatArray:
    """The matrix (9, 9) of the Lie bracket with xi."""
    ad = np.kron(np.eye(3), skew(xi[6:9]))
    ad[:3, 6:], ad[3:6, 6:] = skew(xi[:3]), skew(xi[3:6])
    return ad


def left_jacobian(xi: FloatArray) -> FloatArray:
    """Jl (9, 9) of SE_2(3): the sum of ad^k / (k + 1)!."""
    ad, term, J = small_adjoint(xi), np.eye(9), np.eye(9)
    for k in range(1, 60):
        term = term @ ad / (k + 1)
        J = J + term
    return J


def canonical_from_right(x: FloatArray) -> FloatArray:
    """T (15, 15) from the right-invariant errors, biases additive, to the canonical ones."""
    T = np.eye(15)
    T[:3, 6:9], T[3:6, 6:9] = -skew(x[:3]), -skew(x[3:6])
    T[6:9, 6:9] = quat_to_dcm(x[6:10]).T
    return T


def canonical_from_left(x: FloatArray) -> FloatArray:
    T = canonical_from_right(x)
    T[:9, :9] = T[:9, :9] @ adjoint(x)
    return T


def core(x: FloatArray) -> FloatArray:
    """What the group knows of a state: p, v, C."""
    return np.concatenate([x[:6], quat_to_dcm(x[6:10]).ravel()])


@pytest.mark.parametrize("seed", SEEDS)
def test_canonical_errors_of_a_group_error(seed: int) -> None:
    x = random_state(seed)
    T = canonical_from_right(x)
    h = 1e-6
    for i in range(9):
        ends = []
        for sign in (1.0, -1.0):
            xi = np.zeros(9)
            xi[i] = sign * h
            chi = expm(wedge(xi)) @ element(x)
            C = quat_to_dcm(x[6:10])
            theta = vee_rotation(C.T @ chi[:3, :3])
            ends.append(np.concatenate([chi[:3, 4], chi[:3, 3], theta]))
        assert_allclose((ends[0] - ends[1]) / (2 * h), T[:9, i], atol=1e-6)


def vee_rotation(C: FloatArray) -> FloatArray:
    """The rotation vector of a small rotation."""
    return 0.5 * np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])


@pytest.mark.parametrize("size", [1e-4, 0.02, 0.04, 0.5, 2.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_step_is_the_exponential_of_the_group(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    x = random_state(seed)
    d = rng.normal(size=15) * np.repeat([30.0, 5.0, 0.0, 0.01, 0.1], 3)
    theta = rng.normal(size=3)
    d[6:9] = size * theta / np.linalg.norm(theta)
    xi = np.linalg.solve(canonical_from_right(x), d)
    expected = expm(wedge(xi[:9])) @ element(x)
    moved = x.copy()
    group_step(moved, d, COLUMNS, np.empty((BLOCKS, 3, 3)))
    assert_allclose(element(moved), expected, atol=1e-9)
    assert_allclose(moved[10:16], x[10:16] + d[9:], rtol=1e-15)


@pytest.mark.parametrize("size", [1e-4, 0.02, 0.04, 0.5, 2.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_a_step(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    x = random_state(seed)
    d = rng.normal(size=15) * np.repeat([30.0, 5.0, 0.0, 0.01, 0.1], 3)
    theta = rng.normal(size=3)
    d[6:9] = size * theta / np.linalg.norm(theta)

    def stepped(d: FloatArray) -> tuple[FloatArray, FloatArray]:
        y, G = x.copy(), np.empty((BLOCKS, 3, 3))
        group_step(y, d, COLUMNS, G)
        return y, G

    y, blocks = stepped(d)
    G = np.eye(15)
    turn_rows(G, blocks)
    h = 1e-5
    for i in range(15):
        e = np.zeros(15)
        e[i] = h
        ends = [boxminus(stepped(d + sign * e)[0], y, COLUMNS) for sign in (1.0, -1.0)]
        assert_allclose((ends[0] - ends[1]) / (2 * h), G[:, i], atol=2e-6)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("seed", SEEDS)
def test_first_iterate_is_the_update_of_the_group(seed: int, side: str) -> None:
    """Gain, exponential and covariance worked out over invariant errors; multiplied from either side."""
    rng = np.random.default_rng(seed)
    x = random_state(seed)
    A = rng.normal(size=(15, 15)) * np.repeat([10.0, 2.0, 0.5, 0.01, 0.1], 3)[:, np.newaxis]
    state = FilterState(x.copy(), A @ A.T, np.zeros(6), 0)
    z = x[:3] + rng.normal(size=3) * 10.0
    R = np.diag([1.0, 2.0, 3.0])
    x[16:19] = state.x[16:19] = [0.5, -0.3, 0.2]
    m = Measurement("gnss_position", 0, "", 0, 0, z, R, np.empty(0), gnss_position.model, 5.0)
    r, H = m.linearize(x, state.u)

    canonical = canonical_from_right if side == "right" else canonical_from_left
    T = canonical(x)
    P = np.linalg.solve(T, np.linalg.solve(T, state.P).T)
    H_own = H[:, :15] @ T
    K = P @ H_own.T @ np.linalg.inv(H_own @ P @ H_own.T + R)
    xi = K @ r
    after = (np.eye(15) - K @ H_own) @ P
    step = expm(wedge(xi[:9]))
    chi = step @ element(x) if side == "right" else element(x) @ step
    J = np.eye(15)
    J[:9, :9] = left_jacobian(xi[:9] if side == "right" else -xi[:9])

    once = FilterSettings(iterated=IteratedSettings(iterations=1))
    make("iekf", NOISE, settings=once).update(state, m, math.inf)
    assert_allclose(element(state.x), chi, atol=1e-8)
    T = canonical(state.x) @ J
    expected = T @ after @ T.T
    scale = np.sqrt(np.diag(expected))
    assert_allclose(state.P / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-7)


def test_a_far_correction_leaves_position_and_heading_apart() -> None:
    """After one step alone, 100 m of correction and a vague heading would be taken for a vague position."""
    x = random_state(2)
    x[6:10] = euler_to_quat(0.0, 0.0, 1.0)
    sigma = np.repeat([100.0, 0.3, 0.03, 0.01, 0.1], 3)
    sigma[8] = 1.0
    z = x[:3] + np.array([80.0, -60.0, 5.0])
    found = []
    for iterations in (1, 4):
        settings = FilterSettings(iterated=IteratedSettings(iterations=iterations))
        state = FilterState(x.copy(), np.diag(sigma**2), np.zeros(6), 0)
        m = Measurement(
            "gnss_position", 0, "", 0, 0, z, np.eye(3), np.empty(0), gnss_position.model, 5.0
        )
        make("iekf", NOISE, settings=settings).update(state, m, math.inf)
        found.append(np.sqrt(np.diag(state.P)))
        assert_allclose(state.x[:3], z, atol=0.05)
    assert np.all(found[0][:2] > 20.0)
    assert_allclose(found[1][:3], 1.0, rtol=1e-3)
    assert np.all(found[1][6:9] > 0.85 * sigma[6:9])


def transition_of(x: FloatArray, w_b: FloatArray, f_b: FloatArray, dt: float) -> FloatArray:
    """Phi (15, 15) over canonical errors; x moves."""
    w, f = tuple(w_b.tolist()), tuple(f_b.tolist())
    phi, dv = ins.increments_from_rates(w, f, w, f, dt)
    A, C = np.empty((ins.BLOCKS, 3, 3)), np.empty((3, 3))
    g = ins.mechanize(x, phi, dv, dt, FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n, C)
    ins.transition(A, C, g, phi, dv, dt, FRAME.w_ie_n)
    Phi = np.eye(15)
    moving = np.empty((9, 15))
    ins.apply_transition(np.eye(15), A, C, dt, moving, 15, 15, 15)
    Phi[:9] = moving
    return Phi


@pytest.mark.parametrize("seed", SEEDS)
def test_dynamics_of_the_invariant_error(seed: int) -> None:
    """F of docs/theory/iekf.md: what is not of the Earth's curvature and rotation knows nothing of the state."""
    rng = np.random.default_rng(seed)
    x = random_state(seed)
    p, v, C, w = x[:3].copy(), x[3:6].copy(), quat_to_dcm(x[6:10]), FRAME.w_ie_n
    g = gravity_n(p, FRAME.r0_e, FRAME.C_ne)
    gradient = np.empty((3, 3))
    write_gravity_gradient(gradient, *g)
    F = np.zeros((15, 15))
    F[:3, 3:6] = np.eye(3)
    F[3:6, 6:9] = skew(g)
    F[3:6, :3] = gradient
    F[3:6, 3:6] = -2.0 * skew(w)
    F[3:6, 6:9] += skew(v) @ skew(w) - gradient @ skew(p)
    F[:3, 6:9] = -skew(p) @ skew(w)
    F[6:9, 6:9] = -skew(w)
    F[:3, 9:12], F[3:6, 9:12], F[6:9, 9:12] = -skew(p) @ C, -skew(v) @ C, -C
    F[3:6, 12:15] = -C
    dt = 1e-4
    before = canonical_from_right(x)
    w_b, f_b = rng.normal(size=3), rng.normal(size=3) * 10.0
    Phi = transition_of(x, w_b, f_b, dt)
    own = np.linalg.solve(canonical_from_right(x), Phi @ before)
    tolerance = np.full((15, 15), 1e-6)
    # what grows with |p|, |v| and the specific force is of the first order in dt
    tolerance[:6, 9:15] = 1.0
    tolerance[3:6, 6:9] = tolerance[6:9, 9:12] = tolerance[3:6, 12:15] = 2e-3
    tolerance[:3, 6:9] = 2e-3
    assert np.all(np.abs((own - np.eye(15)) / dt - F) < tolerance)


def test_error_is_linear_however_large_and_wherever_the_flight_goes() -> None:
    """Without noise, biases and Earth rate, log(chi_true chi^-1) obeys one linear map along every trajectory."""
    rng = np.random.default_rng(5)
    still, C, dt, n = np.zeros(3), np.empty((3, 3)), 0.01, 200
    g = gravity_n(np.zeros(3), FRAME.r0_e, FRAME.C_ne)
    xi0 = np.concatenate([[5.0, -3.0, 2.0], [1.0, 2.0, -0.5], [0.1, -0.2, 1.0]])
    t = n * dt
    expected = xi0.copy()
    expected[3:6] += t * np.cross(g, xi0[6:9])
    expected[:3] += t * xi0[3:6] + 0.5 * t * t * np.cross(g, xi0[6:9])
    for _ in range(3):
        x = random_state(int(rng.integers(100)))
        x[:6] *= 0.1
        x[10:16] = 0.0
        true = x.copy()
        chi = expm(wedge(xi0)) @ element(x)
        true[:3], true[3:6] = chi[:3, 4], chi[:3, 3]
        true[6:10] = quat_mul(rotation(xi0[6:9]), x[6:10])
        for _ in range(n):
            w, f = tuple(rng.normal(size=3).tolist()), tuple((rng.normal(size=3) * 10.0).tolist())
            phi, dv = ins.increments_from_rates(w, f, w, f, dt)
            for y in (x, true):
                ins.mechanize(y, phi, dv, dt, FRAME.r0_e, FRAME.C_ne, still, C)
        xi = vee(np.real(logm(element(true) @ np.linalg.inv(element(x)))))
        # gravity is not quite the same at both places
        assert_allclose(xi, expected, atol=5e-3)
        additive = np.concatenate([true[:6] - x[:6], quat_log(quat_mul(true[6:10], x[6:10]))])
        assert np.linalg.norm(additive[:6] - expected[:6]) > 3.0


def rotation(phi: FloatArray) -> FloatArray:
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    d = np.zeros(15)
    d[6:9] = phi
    boxplus(x, d, COLUMNS)
    return x[6:10]


def assert_covariance(P: FloatArray) -> None:
    assert_array_equal(P, P.T)
    scale = 1.0 / np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P * scale[:, None] * scale)[0] > 1e-12


@pytest.mark.jit
def test_covariance_after_a_hundred_thousand_steps() -> None:
    """Random motion with large corrections: the measurements wander by more than the filter expects."""
    rng = np.random.default_rng(8)
    layout = Layout.of((*Layout.of().blocks, "l_b", "tau"))
    algorithm = make("iekf", NOISE, layout)
    x = random_state(1)
    P = np.diag(np.repeat([1.0, 0.3, 0.3, 0.01, 0.2, 0.1], [3, 3, 3, 3, 3, 4]) ** 2)
    state = FilterState(x, P, np.zeros(6), 0)
    rows = RowBlock.empty(1)
    R = np.eye(3) * 0.02**2
    for k in range(25_000):
        imu = rng.normal(size=(4, 6)) * np.repeat([1.0, 5.0], 3)
        t = state.t_us + 4000 * np.arange(1, 5)
        algorithm.walk(state, FRAME, t, imu, int(t[-1]), state.t_us, -1, rows)
        z = 0.1 * rng.normal(size=3)
        m = Measurement("gnss_position", 0, "", 0, 0, z, R, np.empty(0), gnss_position.model, 5.0)
        algorithm.update(state, m, math.inf)
        if k % 1000 == 0:
            assert_covariance(state.P)
    assert_covariance(state.P)
    assert np.all(np.isfinite(state.x))


def flight(seed: int) -> Measurements:
    scenario = dataclasses.replace(load("quad_mission"), truth_rate=50)
    return simulate(scenario, seed, 42.0)


def heading_errors(
    algorithm: Filter, m: Measurements, wrong_deg: float
) -> tuple[FloatArray, FloatArray]:
    """(seconds since the first horizontal acceleration above 1 m/s^2, heading errors in deg) of a run.

    It starts in the hover before that with a heading that is wrong by its sigma; GNSS is all there is.
    """
    frame = TangentFrame.at(Origin(math.radians(47.3977), math.radians(8.5456), 488.0))
    truth, imu = m.truth, np.hstack([m.imu.gyro_b, m.imu.accel_b])
    push = np.linalg.norm(np.gradient(truth.v_n[:, :2], truth.t_us * 1e-6, axis=0), axis=1)
    begin = int(truth.t_us[np.argmax(push > 1.0)])
    i = int(np.searchsorted(truth.t_us, begin - 8_000_000))
    k = int(np.searchsorted(m.imu.t_us, truth.t_us[i]))
    x = np.zeros(X_SIZE)
    x[:3], x[3:6] = truth.p_n[i], truth.v_n[i]
    x[6:10] = quat_mul(euler_to_quat(0.0, 0.0, math.radians(wrong_deg)), truth.q_nb[i])
    sigma = np.repeat([0.5, 0.1, 0.01, 0.005, 0.05], 3)
    sigma[8] = math.radians(wrong_deg)
    state = FilterState(x, np.diag(sigma**2), imu[k].copy(), int(m.imu.t_us[k]))
    rows = RowBlock.empty(1)
    times, errors = [], []
    for fix in m.fixes:
        t_us = fix.t_us
        end = int(np.searchsorted(m.imu.t_us, t_us, "right"))
        if t_us <= state.t_us or end >= len(imu):
            continue
        part = slice(k + 1, end + 1)
        algorithm.walk(
            state, frame, m.imu.t_us[part], imu[part], t_us, int(m.imu.t_us[k]), -1, rows
        )
        k = end - 1
        for measured in (
            gnss_position.measure(fix, t_us, frame, 0.5, 0.8, 5.0),
            gnss_velocity.measure(fix, t_us, frame, 0.1, 5.0),
        ):
            assert measured is not None
            algorithm.update(state, measured, math.inf)
        j = int(np.searchsorted(truth.t_us, t_us))
        off = quat_to_euler(state.x[6:10])[2] - quat_to_euler(truth.q_nb[j])[2]
        times.append((t_us - begin) * 1e-6)
        errors.append(math.degrees(wrap_pi(off)))
    return np.array(times), np.array(errors)


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("wrong_deg", [45.0, 75.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_heading_is_found_in_motion(seed: int, wrong_deg: float) -> None:
    t, errors = heading_errors(make("iekf", NOISE), flight(seed), wrong_deg)
    assert abs(errors[0]) > 0.5 * wrong_deg
    assert t[-1] > 22.0
    assert np.all(np.abs(errors[t > 20.0]) < 3.0)


def test_made_by_name() -> None:
    algorithm = make("iekf", NOISE)
    assert isinstance(algorithm, Iekf)
    assert isinstance(algorithm, Eskf)


@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_a_step_with_gravity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = Layout.of((*Layout.of().blocks, "g_n")).columns
    x, d = random_state(seed), 0.3 * rng.normal(size=17)
    x[24:26] = 0.2 * rng.normal(size=2)
    y, blocks, G = x.copy(), np.empty((BLOCKS + 1, 3, 3)), np.eye(17)
    group_step(y, d, columns, blocks)
    turn_rows(G, blocks)
    h = 1e-6
    for i in range(17):
        ends = []
        for sign in (1.0, -1.0):
            e, z = d.copy(), x.copy()
            e[i] += sign * h
            group_step(z, e, columns, np.empty((BLOCKS + 1, 3, 3)))
            ends.append(boxminus(z, y, columns))
        assert_allclose((ends[0] - ends[1]) / (2 * h), G[:, i], atol=1e-6)
