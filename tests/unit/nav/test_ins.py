"""The error dynamics: Phi against numeric differentiation of the mechanization itself, and P's propagation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from mavins.nav import ins
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, X_SIZE, Layout, boxminus, boxplus
from mavins.nav.so3 import quat_exp, quat_log, quat_mul
from mavins.types import FloatArray, Origin

FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
COLUMNS = Layout.of().columns
SEEDS = range(6)
DT = 0.01


def random_state(rng: np.random.Generator) -> FloatArray:
    x = np.zeros(X_SIZE)
    x[0:3] = rng.normal(size=3) * 3e3
    x[3:6] = rng.normal(size=3) * 15.0
    x[6:10] = quat_exp(rng.uniform(-1.6, 1.6, 3))
    x[10:13] = rng.normal(size=3) * 0.01
    x[13:16] = rng.normal(size=3) * 0.1
    return x


def random_readings(rng: np.random.Generator) -> FloatArray:
    """Two neighbouring readings (2, 6) of a vehicle that turns and accelerates hard."""
    first = np.concatenate([rng.normal(size=3) * 1.5, [0, 0, -9.8] + rng.normal(size=3) * 4.0])
    return np.array([first, first + rng.normal(size=6) * [0.1] * 3 + rng.normal(size=6) * 0.1])


def increments(x: FloatArray, u: FloatArray, dt: float) -> tuple[ins.Vector, ins.Vector]:
    w0, w1 = (tuple((row[:3] - x[10:13]).tolist()) for row in u)
    f0, f1 = (tuple((row[3:] - x[13:16]).tolist()) for row in u)
    return ins.increments_from_rates(w0, f0, w1, f1, dt)


def moved(x: FloatArray, u: FloatArray, dt: float) -> FloatArray:
    after = x.copy()
    phi, dv = increments(x, u, dt)
    ins.mechanize(after, phi, dv, dt, FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n, np.empty((3, 3)))
    return after


def analytic(x: FloatArray, u: FloatArray, dt: float) -> FloatArray:
    phi, dv = increments(x, u, dt)
    C, A = np.empty((3, 3)), np.empty((ins.BLOCKS, 3, 3))
    g = ins.mechanize(x.copy(), phi, dv, dt, FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n, C)
    ins.transition(A, C, g, phi, dv, dt, FRAME.w_ie_n)
    Phi = np.eye(15)
    ins.apply_transition(np.eye(15), A, C, dt, Phi[: ins.MOVING], 15, 15, 15)
    return Phi


def numeric(x: FloatArray, u: FloatArray, dt: float) -> FloatArray:
    steps = np.repeat([10.0, 1e-2, 1e-5, 1e-5, 1e-3], 3)
    Phi = np.empty((15, 15))
    for i, h in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            y = x.copy()
            d = np.zeros(15)
            d[i] = sign * h
            boxplus(y, d, COLUMNS)
            ends.append(moved(y, u, dt))
        Phi[:, i] = boxminus(ends[0], ends[1], COLUMNS) / (2 * h)
    return Phi


# Phi has each block's leading term; what is left is of the next order in dt. The bounds are for rates of some rad/s,
# specific forces of some 10 m/s^2 and places some km away.
BOUNDS = np.array(
    [
        [1e-11, 1e-9, 4e-7, 4e-7, 4e-6],
        [1e-9, 1e-9, 1e-6, 4e-5, 5e-4],
        [1e-13, 1e-12, 1e-9, 4e-5, 1e-12],
        [1e-13, 1e-12, 1e-12, 1e-11, 1e-12],
        [1e-13, 1e-12, 1e-12, 1e-12, 1e-13],
    ]
)


@pytest.mark.parametrize("seed", SEEDS)
def test_transition_is_the_derivative_of_the_mechanization(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, u = random_state(rng), random_readings(rng)
    gap = np.abs(analytic(x, u, DT) - numeric(x, u, DT))
    worst = gap.reshape(5, 3, 5, 3).max(axis=(1, 3))
    assert np.all(worst <= BOUNDS), f"{worst.tolist()}"


def test_what_the_transition_leaves_out_falls_with_the_square_of_the_step() -> None:
    rng = np.random.default_rng(1)
    x, u = random_state(rng), random_readings(rng)
    gaps = [np.abs(analytic(x, u, dt) - numeric(x, u, dt))[:9].max() for dt in (0.04, 0.02, 0.01)]
    assert gaps[0] / gaps[1] > 3.5
    assert gaps[1] / gaps[2] > 3.5


@pytest.mark.parametrize("size", [15, 19])
def test_covariance_goes_through_the_transition(size: int) -> None:
    rng = np.random.default_rng(3)
    x, u = random_state(rng), random_readings(rng)
    A = rng.normal(size=(size, size))
    P = A @ A.T
    Phi = np.eye(size)
    Phi[:15, :15] = analytic(x, u, DT)
    noise = np.array([0.015, 0.35, 1e-4, 3e-3])
    Q = np.zeros((size, size))
    psd = noise**2 * DT
    Q[0:3, 0:3] = np.eye(3) * psd[1] * DT**2 / 3
    Q[0:3, 3:6] = Q[3:6, 0:3] = np.eye(3) * psd[1] * DT / 2
    Q[3:6, 3:6] = np.eye(3) * psd[1]
    Q[6:9, 6:9] = np.eye(3) * psd[0]
    Q[9:12, 9:12] = np.eye(3) * psd[2]
    Q[12:15, 12:15] = np.eye(3) * psd[3]
    expected = Phi @ P @ Phi.T + Q
    phi, dv = increments(x, u, DT)
    frame = (FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n)
    ins.predict(x, P, phi, dv, DT, noise, 1.0, *frame, ins.workspace(size, False))
    assert_allclose(P, expected, rtol=1e-12, atol=1e-12)
    assert_array_equal(P, P.T)


def exact(
    w: FloatArray, dw: FloatArray, f: FloatArray, df: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """(phi, dv) for rates w + dw t and forces f + df t, from the differential equations."""

    def slope(t: float, y: FloatArray) -> FloatArray:
        q, rate = y[:4], w + dw * t
        turned = quat_mul(quat_mul(q, np.array([0.0, *(f + df * t)])), q * [1, -1, -1, -1])
        return np.concatenate([0.5 * quat_mul(q, np.array([0.0, *rate])), turned[1:]])

    start = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    y = solve_ivp(slope, (0.0, dt), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    return quat_log(y[:4] / np.linalg.norm(y[:4])), y[4:]


def tuples(*vectors: FloatArray) -> list[ins.Vector]:
    return [tuple(v.tolist()) for v in vectors]


@pytest.mark.parametrize("seed", range(3))
def test_increments_of_linear_signals(seed: int) -> None:
    """Exact to the fourth order of the interval: halving it leaves a sixteenth, or less."""
    w, dw, f, df = np.random.default_rng(seed).normal(size=(4, 3)) * [[1], [20], [9], [100]]
    gaps = []
    for dt in (0.02, 0.01):
        got = ins.increments_from_rates(*tuples(w, f, w + dw * dt, f + df * dt), dt)
        gaps.append(
            [np.abs(a - b).max() for a, b in zip(got, exact(w, dw, f, df, dt), strict=True)]
        )
    assert gaps[1][0] < 2e-7
    assert gaps[1][1] < 1e-6
    assert gaps[0][0] > 12.0 * gaps[1][0]
    assert gaps[0][1] > 12.0 * gaps[1][1]


def test_integrals_of_a_coning_motion_need_the_coning_term() -> None:
    """The rates of an axis that runs round a cone: only the coning term keeps the attitude from drifting."""
    a, omega, dt, n = 0.05, 2 * math.pi * 5.0, 0.004, 500
    t = np.arange(-1, n + 1) * dt
    amplitude = math.sin(a)
    integrals = np.column_stack(
        [
            np.full(n + 1, -2 * omega * math.sin(a / 2) ** 2 * dt),
            amplitude * np.diff(np.cos(omega * t)),
            amplitude * np.diff(np.sin(omega * t)),
        ]
    )
    drift = {}
    for k in (1.0, 0.0):
        q = np.array([1.0, 0.0, 0.0, 0.0])
        for before, now in itertools.pairwise(integrals):
            zero = np.zeros(3)
            phi, _ = ins.increments_from_integrals(*tuples(before, zero, now, zero))
            q = quat_mul(q, quat_exp(now + k * (np.array(phi) - now)))
        drift[k] = abs(quat_log(q)[0])
    assert drift[1.0] < 0.02 * drift[0.0]


def test_integrals_and_rates_agree_on_a_linear_signal() -> None:
    rng = np.random.default_rng(9)
    w0, dw, f0, df = rng.normal(size=(4, 3))
    dt = 0.01

    def integral(a: FloatArray, slope: FloatArray, k: int) -> tuple[float, ...]:
        return tuple((dt * (a + slope * dt * (k + 0.5))).tolist())

    def at(a: FloatArray, slope: FloatArray, k: int) -> tuple[float, ...]:
        return tuple((a + slope * dt * k).tolist())

    rates = ins.increments_from_rates(
        at(w0, dw, 1), at(f0, df, 1), at(w0, dw, 2), at(f0, df, 2), dt
    )
    integrals = ins.increments_from_integrals(
        integral(w0, dw, 0), integral(f0, df, 0), integral(w0, dw, 1), integral(f0, df, 1)
    )
    for a, b in zip(rates, integrals, strict=True):
        assert_allclose(a, b, atol=1e-8)


@pytest.mark.parametrize("t", [(0.0, 0.0), (0.02, -0.3)])
@pytest.mark.parametrize("seed", SEEDS)
def test_an_error_of_gravity_s_direction_against_finite_differences(
    seed: int, t: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    layout = Layout.of((*CORE, "g_n"))
    x, u = random_state(rng), random_readings(rng)
    x[24:26] = t
    phi, dv = increments(x, u, DT)
    K, h = np.empty((6, 2)), 1e-4
    earth = (FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n)
    g = ins.mechanize(x.copy(), phi, dv, DT, *earth, np.empty((3, 3)))
    ins.write_gravity_transition(K, x, g, DT)
    for j in range(2):
        ends = []
        for sign in (1.0, -1.0):
            y, d = x.copy(), np.zeros(17)
            d[15 + j] = sign * h
            boxplus(y, d, layout.columns)
            ends.append(moved(y, u, DT))
        column = boxminus(ends[0], ends[1], layout.columns) / (2 * h)
        # what the Earth's turn makes of it in an interval, g w dt^2, is left out
        assert_allclose(column[:6], K[:, j], rtol=1e-5, atol=1e-7)
        assert_allclose(column[6:15], 0.0, atol=1e-10)
    P = rng.normal(size=(17, 17))
    P = P @ P.T
    T = np.eye(17)
    T[:6, 15:] = K
    after = P.copy()
    ins.feel_gravity(after, K)
    assert_allclose(after, T @ P @ T.T)
    assert_array_equal(after, after.T)
