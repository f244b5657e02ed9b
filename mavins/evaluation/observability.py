"""Local observability along a course: what measurements say of each error state, manoeuvre by manoeuvre.

    O = sum_k Phi(k, 0)^T H_k^T R_k^-1 H_k Phi(k, 0)

over the measurements of a segment is the information on the errors at its beginning. Scaled by prior sigmas, S O S,
its singular values count in units of the prior's own information: where one is above 1 the data beat the prior.

Sources: Chen, "Linear System Theory and Design" (1999), for the Gramian; Goshen-Meskin and Bar-Itzhack, "Observability
analysis of piece-wise constant systems" (1992); Ham and Brown (1983) for reading eigenvalues and eigenvectors.
Theory: docs/theory/observability.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.aiding import Measurement
from mavins.estimator.settings import Settings
from mavins.evaluation.course import Course, label_of
from mavins.filters.walking import reading_within
from mavins.nav.earth import gravity_at
from mavins.nav.ins import (
    BLOCKS,
    MOVING,
    add_gravity_transition,
    apply_transition,
    increments_from_rates,
    transition,
    write_gravity_transition,
)
from mavins.nav.kernels import kernel
from mavins.nav.layout import (
    B_A,
    B_BARO,
    B_G,
    B_M,
    CANONICAL_SIZE,
    G_N,
    L_B,
    P_N,
    TAU,
    THETA_B,
    V_N,
    Layout,
)
from mavins.nav.s2 import tilted
from mavins.nav.so3 import write_dcm
from mavins.types import FloatArray, IntArray

YAW_SIGMA: Final = math.radians(10.0)
"""The prior of the yaw: a poor start, which a filter can still be linearized about."""
VISIBLE: Final = 0.5
"""A state has become visible once its sigma is below this share of the prior's."""
EPOCH_US: Final = 200_000
"""Posterior sigmas are taken so often."""
_AXES: Final = {"p_n": "NED", "v_n": "NED", "tau": ("",), "b_baro": ("",), "g_n": "NE"}


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of the course, by itself, and what is known once it is over.

    `values` (n,), falling, are the singular values of S O S, `weakest` (n,) the unit vector of the last of them.
    `ratios` (n,) are posterior sigma / prior sigma of the errors at the course's beginning, given all data so far.
    """

    start_us: int
    end_us: int
    label: str
    measurements: int
    values: FloatArray
    weakest: FloatArray
    ratios: FloatArray

    @property
    def rank(self) -> int:
        """The number of directions in which the segment's data beat the prior."""
        return int(np.count_nonzero(self.values >= 1.0))

    @property
    def condition(self) -> float:
        """The largest singular value over the smallest; inf where that is no more than rounding."""
        largest, smallest = float(self.values[0]), float(self.values[-1])
        rounding = largest * len(self.values) * float(np.finfo(float).eps)
        return largest / smallest if smallest > rounding else math.inf


@dataclass(frozen=True, slots=True)
class Analysis:
    """The segments of a course, and `ratios` (K, n) as in Segment at instants `t_us` (K,).

    `visible_us[i]` is the first of these instants at which state i has become visible, -1 if it never does.
    """

    states: tuple[str, ...]
    prior: FloatArray
    segments: tuple[Segment, ...]
    t_us: IntArray
    ratios: FloatArray
    visible_us: tuple[int, ...]


def names_of(layout: Layout) -> tuple[str, ...]:
    """A name for each error state, such as b_g.z."""
    return tuple(
        f"{block}.{axis}" if axis else block
        for block in layout.blocks
        for axis in _AXES.get(block, "xyz")
    )


def prior_sigmas(settings: Settings) -> FloatArray:
    """Prior sigmas (25,) of the canonical errors: what the settings assume where nothing has been measured yet."""
    gnss, imu, states = settings.gnss, settings.imu, settings.states
    tilt = math.radians(settings.alignment.moving_sigma_deg)
    sigmas = np.empty(CANONICAL_SIZE)
    sigmas[P_N] = gnss.position_sigma, gnss.position_sigma, gnss.altitude_sigma
    sigmas[V_N] = gnss.velocity_sigma
    sigmas[THETA_B] = tilt, tilt, YAW_SIGMA
    sigmas[B_G] = imu.gyro_bias_sigma
    sigmas[B_A] = imu.accel_bias_sigma
    sigmas[L_B] = states.lever_arm_sigma
    sigmas[TAU] = states.gnss_delay_sigma
    sigmas[B_BARO] = states.baro_bias_sigma
    sigmas[B_M] = states.mag_bias_sigma
    sigmas[G_N] = math.radians(states.gravity_sigma_deg)
    return sigmas


@kernel
def carry(
    Phi: FloatArray,
    t_us: IntArray,
    x: FloatArray,
    u: FloatArray,
    first: int,
    last: int,
    has_gravity: bool,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
) -> None:
    """Phi (n, n) <- Phi(last, first) Phi, in place, along samples of states x (N, 26) with readings u (N, 6)."""
    n = Phi.shape[0]
    C = np.empty((3, 3))
    A = np.empty((BLOCKS, 3, 3))
    moved = np.empty((MOVING, n))
    K = np.empty((6, 2 if has_gravity else 0))
    for k in range(first, last):
        dt_us = t_us[k + 1] - t_us[k]
        dt = dt_us * 1e-6
        write_dcm(C, (x[k, 6], x[k, 7], x[k, 8], x[k, 9]))
        g = tilted((x[k, 24], x[k, 25]), gravity_at(x[k, 0], x[k, 1], x[k, 2], r0_e, C_ne))
        w0, f0 = reading_within(x[k], u[k], u[k + 1], 0.0, dt_us)
        w1, f1 = reading_within(x[k], u[k], u[k + 1], 1.0, dt_us)
        phi, dv = increments_from_rates(w0, f0, w1, f1, dt)
        transition(A, C, g, phi, dv, dt, w_ie_n)
        apply_transition(Phi, A, C, dt, moved, n, n, n)
        for i in range(MOVING):
            for j in range(n):
                Phi[i, j] = moved[i, j]
        if K.shape[1]:
            write_gravity_transition(K, x[k], g, dt)
            add_gravity_transition(Phi, K)


def information(H: FloatArray, R: FloatArray, Phi: FloatArray) -> FloatArray:
    """One term of the Gramian, Phi^T H^T R^-1 H Phi (n, n), for H (m, n) and R (m, m)."""
    J = H @ Phi
    return J.T @ np.linalg.solve(R, J)


def spectrum(gramian: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The singular values (n,) of S O S, falling, and the unit vector (n,) of the smallest, S = diag(prior)."""
    values, vectors = np.linalg.eigh(gramian * np.outer(prior, prior))
    return np.maximum(values[::-1], 0.0), vectors[:, 0]


def posterior(gramian: FloatArray, prior: FloatArray) -> FloatArray:
    """Posterior sigma / prior sigma (n,): sqrt(diag((I + S O S)^-1))."""
    scaled = np.eye(len(prior)) + gramian * np.outer(prior, prior)
    return np.sqrt(np.diagonal(np.linalg.inv(scaled)))


def analyse(
    course: Course,
    layout: Layout,
    prior: FloatArray,
    window: float,
    progress: Callable[[float], None] = lambda _: None,
) -> Analysis:
    """The observability of the layout's errors along a course, in segments of `window` s; prior (25,)."""
    sigmas = prior[layout.columns]
    n = layout.size
    known, start = np.zeros((n, n)), np.eye(n)
    segments: list[Segment] = []
    epochs: list[int] = []
    ratios: list[FloatArray] = []
    at_us = np.array([m.t_us for m in course.measurements], dtype=np.int64)
    places = np.searchsorted(course.t_us, at_us)
    places[at_us < course.t_us[0]] = -1
    edges = _edges(course.t_us, window)
    for first, last in itertools.pairwise(edges):
        inside = np.flatnonzero((places >= first) & (places < last)).tolist()
        local, Phi, now = np.zeros((n, n)), np.eye(n), first
        for i in inside:
            k, m = int(places[i]), course.measurements[i]
            if k > now:
                if not epochs or course.t_us[now] - epochs[-1] >= EPOCH_US:
                    epochs.append(int(course.t_us[now]))
                    ratios.append(posterior(known + start.T @ local @ start, sigmas))
                _carry(Phi, course, now, k, layout)
                now = k
            local += _term(m, course, k, Phi, layout)
        _carry(Phi, course, now, last, layout)
        known += start.T @ local @ start
        start = Phi @ start
        after = posterior(known, sigmas)
        epochs.append(int(course.t_us[last]))
        ratios.append(after)
        bounds = int(course.t_us[first]), int(course.t_us[last])
        label = label_of(course, first, last)
        segments.append(Segment(*bounds, label, len(inside), *spectrum(local, sigmas), after))
        progress(last / edges[-1])
    table = np.array(ratios)
    visible = tuple(
        epochs[int(below[0])] if len(below := np.flatnonzero(table[:, i] < VISIBLE)) else -1
        for i in range(n)
    )
    times = np.array(epochs, dtype=np.int64)
    return Analysis(names_of(layout), sigmas, tuple(segments), times, table, visible)


def _carry(Phi: FloatArray, course: Course, first: int, last: int, layout: Layout) -> None:
    frame = course.frame
    earth = (frame.r0_e, frame.C_ne, frame.w_ie_n)
    carry(Phi, course.t_us, course.x, course.u, first, last, layout.has_gravity, *earth)


def _term(m: Measurement, course: Course, k: int, Phi: FloatArray, layout: Layout) -> FloatArray:
    _, H = m.linearize(course.x[k], course.u[k])
    return information(H[:, layout.columns], m.R, Phi)


def _edges(t_us: IntArray, window: float) -> list[int]:
    """The samples at which segments begin and end; a rest shorter than half a window joins the last."""
    length = t_us[-1] - t_us[0]
    count = max(1, int(length * 1e-6 / window + 0.5))
    inner = t_us[0] + np.arange(1, count) * round(window * 1e6)
    edges = [0, *np.searchsorted(t_us, inner).tolist(), len(t_us) - 1]
    return list(dict.fromkeys(edges))
