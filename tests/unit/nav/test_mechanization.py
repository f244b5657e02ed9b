"""Ten minutes of `figure8` without any aiding: exact increments, and point samples whose error falls as dt^2."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mavins.nav import ins
from mavins.nav.layout import X_SIZE
from mavins.nav.so3 import quat_conj, quat_log, quat_mul
from mavins.types import FloatArray
from sitl.scenario import load
from sitl.trajectory import Trajectory

pytestmark = pytest.mark.jit
DURATION = 600.0


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return load("figure8").trajectory()


def start_of(trajectory: Trajectory) -> FloatArray:
    k = trajectory.at(np.zeros(1))
    x = np.zeros(X_SIZE)
    x[:10] = np.concatenate([k.p_n[0], k.v_n[0], k.q_nb[0]])
    return x


def errors_at_end(trajectory: Trajectory, x: FloatArray, t: float) -> tuple[float, float, float]:
    k = trajectory.at(np.array([t]))
    turn = quat_log(quat_mul(quat_conj(k.q_nb[0]), x[6:10]))
    p, v = x[:3] - k.p_n[0], x[3:6] - k.v_n[0]
    return tuple(float(np.linalg.norm(e)) for e in (p, v, turn))


def fly(
    trajectory: Trajectory,
    x: FloatArray,
    dt: float,
    increments: list[tuple[ins.Vector, ins.Vector]],
) -> None:
    frame, C = trajectory.frame, np.empty((3, 3))
    for phi, dv in increments:
        ins.mechanize(x, phi, dv, dt, frame.r0_e, frame.C_ne, frame.w_ie_n, C)


def vectors(rows: FloatArray) -> list[ins.Vector]:
    return [tuple(row) for row in rows.tolist()]


def from_integrals(trajectory: Trajectory, dt: float) -> list[tuple[ins.Vector, ins.Vector]]:
    begin = dt * np.arange(-1, round(DURATION / dt))
    a, s = (vectors(part) for part in trajectory.increments(begin, dt))
    return [
        ins.increments_from_integrals(a[i], s[i], a[i + 1], s[i + 1]) for i in range(len(a) - 1)
    ]


def from_samples(
    trajectory: Trajectory, dt: float, duration: float
) -> list[tuple[ins.Vector, ins.Vector]]:
    t = dt * np.arange(round(duration / dt) + 1)
    w, f = (vectors(part) for part in trajectory.inertial(trajectory.at(t)))
    return [
        ins.increments_from_rates(w[i], f[i], w[i + 1], f[i + 1], dt) for i in range(len(w) - 1)
    ]


def test_ten_minutes_of_exact_increments(trajectory: Trajectory) -> None:
    x = start_of(trajectory)
    fly(trajectory, x, 0.01, from_integrals(trajectory, 0.01))
    p, v, turn = errors_at_end(trajectory, x, DURATION)
    print(f"\nexact 100 Hz increments, {DURATION:.0f} s: {p:.2e} m, {v:.2e} m/s, {turn:.2e} rad")
    assert p < 0.1
    assert v < 0.01
    assert turn < 1e-5


def test_point_samples_err_by_the_square_of_the_interval(trajectory: Trajectory) -> None:
    duration = 100.0
    worst = []
    for dt in (0.02, 0.01, 0.005):
        x = start_of(trajectory)
        fly(trajectory, x, dt, from_samples(trajectory, dt, duration))
        worst.append(errors_at_end(trajectory, x, duration))
        p, v, turn = worst[-1]
        print(f"\npoint samples at {1 / dt:.0f} Hz, 100 s: {p:.2e} m, {v:.2e} m/s, {turn:.2e} rad")
    for coarse, fine in itertools.pairwise(worst):
        for a, b in zip(coarse[:2], fine[:2], strict=True):
            assert 3.0 < a / b < 6.0


def test_the_quaternion_stays_a_rotation(trajectory: Trajectory) -> None:
    x = start_of(trajectory)
    fly(trajectory, x, 0.01, from_samples(trajectory, 0.01, 100.0))
    assert abs(np.linalg.norm(x[6:10]) - 1.0) < 1e-14
