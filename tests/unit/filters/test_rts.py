"""The smoother against a batch solution, its transitions against the filter's own, and what stops it."""

from __future__ import annotations

import math

import numpy as np

from mavins.filters.base import FilterState, ImuNoise, RowBlock
from mavins.filters.eskf import Eskf
from mavins.filters.rts import (
    MOVED,
    RESET,
    UPDATED,
    close_transition,
    smooth_back,
    walk_transitions,
)
from mavins.filters.settings import FilterSettings
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, X_SIZE, Layout, boxminus, boxplus
from mavins.types import FloatArray, IntArray, Origin

LAYOUT = Layout.of((*CORE, "tau"))
N = LAYOUT.size
FRAME = TangentFrame.at(Origin(math.radians(47.0), math.radians(8.0), 400.0))


def level() -> FloatArray:
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    return x


def moved_by(e: FloatArray) -> FloatArray:
    x = level()
    boxplus(x, e, LAYOUT.columns)
    return x


class Linear:
    """A linear problem over errors so small that the manifold is flat: a filter's nodes and the batch solution."""

    def __init__(self, intervals: int) -> None:
        rng = np.random.default_rng(5)
        scale = np.ones(N)
        scale[6:9] = 1e-10
        unit = np.diag(scale)
        P = 4.0 * unit @ unit
        e = np.zeros(N)
        nodes: list[tuple[int, FloatArray, FloatArray, FloatArray]] = []
        self.intervals = intervals
        rows: list[tuple[FloatArray, FloatArray]] = [(self._at(0, np.eye(N) / 2.0 / scale), e)]
        nodes.append((MOVED, e, P, np.zeros((9, 15))))
        for k in range(1, intervals + 1):
            A = np.eye(N)
            A[:9, :15] += 0.2 * rng.standard_normal((9, 15))
            Phi = unit @ A @ np.linalg.inv(unit)
            q = 0.3 * scale * rng.uniform(0.5, 1.0, N)
            e, P = Phi @ e, Phi @ P @ Phi.T + np.diag(q * q)
            P = 0.5 * (P + P.T)
            nodes.append((MOVED, e, P, Phi[:9, :15]))
            rows.append(((self._at(k, np.eye(N)) - self._at(k - 1, Phi)) / q[:, None], np.zeros(N)))
            if k % 2:
                continue
            H = rng.standard_normal((3, N)) / scale
            z = rng.standard_normal(3)
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(3))
            e, P = e + K @ (z - H @ e), (np.eye(N) - K @ H) @ P
            P = 0.5 * (P + P.T)
            nodes.append((UPDATED, e, P, np.zeros((9, 15))))
            rows.append((self._at(k, H), z))
        J = np.vstack([row for row, _ in rows])
        z = np.concatenate([value for _, value in rows])
        unscaled = np.tile(scale, intervals + 1)
        J = J * unscaled
        self.cov = np.linalg.inv(J.T @ J)
        self.mean = unscaled * (self.cov @ (J.T @ z))
        self.cov = unscaled[:, None] * self.cov * unscaled
        self.scale = scale
        self.kind = np.array([node[0] for node in nodes])
        self.x = np.array([moved_by(node[1]) for node in nodes])
        self.P = np.array([node[2] for node in nodes])
        self.Phi = np.array([node[3] for node in nodes])

    def _at(self, k: int, block: FloatArray) -> FloatArray:
        out = np.zeros((len(block), N * (self.intervals + 1)))
        out[:, k * N : (k + 1) * N] = block
        return out


def smoothed(problem: Linear, wanted: IntArray) -> tuple[FloatArray, FloatArray]:
    x, P = problem.x.copy(), problem.P.copy()
    lam, Lam = np.zeros(N), np.zeros((N, N))
    smooth_back(problem.kind, wanted, x, P, problem.Phi, lam, Lam, LAYOUT.columns)
    return x, P


def test_a_linear_problem_gives_the_batch_solution() -> None:
    problem = Linear(6)
    everywhere = np.ones(len(problem.kind), dtype=np.int64)
    x, P = smoothed(problem, everywhere)
    instant = np.cumsum(problem.kind == MOVED) - 1
    scale = problem.scale
    for k, at in enumerate(instant.tolist()):
        part = slice(at * N, (at + 1) * N)
        d = boxminus(x[k], level(), LAYOUT.columns)
        np.testing.assert_allclose(d / scale, problem.mean[part] / scale, atol=1e-9)
        C = P[k] / scale / scale[:, None]
        batch = problem.cov[part, part] / scale / scale[:, None]
        np.testing.assert_allclose(C, batch, atol=1e-8)
        np.testing.assert_array_equal(P[k], P[k].T)


def test_the_last_node_stays_and_what_is_not_wanted_does_not_matter() -> None:
    problem = Linear(5)
    everywhere = np.ones(len(problem.kind), dtype=np.int64)
    x, P = smoothed(problem, everywhere)
    np.testing.assert_array_equal(P[-1], problem.P[-1])
    np.testing.assert_allclose(x[-1], problem.x[-1], atol=1e-15)
    first = np.zeros_like(everywhere)
    first[0] = 1
    x_first, P_first = smoothed(problem, first)
    np.testing.assert_array_equal(x_first[0], x[0])
    np.testing.assert_array_equal(P_first[0], P[0])


def test_nothing_passes_a_reset() -> None:
    problem = Linear(4)
    problem.kind[-1] = RESET
    everywhere = np.ones(len(problem.kind), dtype=np.int64)
    _, P = smoothed(problem, everywhere)
    np.testing.assert_array_equal(P[-2], problem.P[-2])
    assert np.trace(P[0][:3, :3]) < np.trace(problem.P[0][:3, :3])


def test_an_indefinite_prediction_stops_what_came_later() -> None:
    problem = Linear(2)
    problem.P[-2, 0, 0] = -1.0
    everywhere = np.ones(len(problem.kind), dtype=np.int64)
    _, P = smoothed(problem, everywhere)
    np.testing.assert_array_equal(P[0], problem.P[0])


def walked(until_us: int) -> tuple[FilterState, FloatArray, FloatArray, FloatArray]:
    """The state after a walk without noise, the P before it, Phi by way of some nodes, and x by their walk."""
    rng = np.random.default_rng(3)
    # a gap that is cut into pieces, and a longer one that is held
    t_us = np.array([4_000, 8_000, 12_000, 150_000, 154_000, 500_000, 504_000, 508_000])
    imu = np.array([0.2, -0.3, 0.5, 1.0, -1.0, -9.8]) + 0.3 * rng.standard_normal((8, 6))
    x = level()
    x[:6] = rng.standard_normal(6)
    root = rng.standard_normal((N, N))
    state = FilterState(x, root @ root.T + np.eye(N), imu[0].copy(), 1_000)
    P, M = state.P.copy(), np.eye(15)
    due = np.array([0, 1, 0, 0, 1, 0, 0, 0])
    Phi = np.empty((3, 9, 15))
    x, u = state.x.copy(), state.u.copy()
    args = (due, until_us, FRAME.r0_e, FRAME.C_ne, FRAME.w_ie_n, Phi)
    count = walk_transitions(M, x, u, state.t_us, t_us, imu, *args)
    assert count == 2
    close_transition(M, Phi[2])
    np.testing.assert_array_equal(M, np.eye(15))
    algorithm = Eskf(ImuNoise(0.0, 0.0, 0.0, 0.0), LAYOUT, FilterSettings())
    algorithm.walk(state, FRAME, t_us, imu, until_us, 0, -1, RowBlock.empty(1, N))
    return state, P, Phi, x


def test_transitions_are_those_of_the_filter() -> None:
    for until_us in (508_000, 505_500):
        state, P, Phi, x = walked(until_us)
        for part in Phi:
            whole = np.eye(N)
            whole[:9, :15] = part
            P = whole @ P @ whole.T
        np.testing.assert_allclose(P, state.P, rtol=1e-11, atol=1e-11)
        np.testing.assert_array_equal(x, state.x)
