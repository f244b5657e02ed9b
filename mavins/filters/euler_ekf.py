"""The direct extended Kalman filter over roll, pitch and yaw: the angles are states, and corrections are added to them.

15 states: p_n, v_n, (roll, pitch, yaw), b_g, b_a. Between calls the state is the common one: an attitude quaternion and
canonical errors, to which theta_b = E^-1 d(roll, pitch, yaw) leads exactly. Source: Barton (2012).
Theory: docs/theory/euler_ekf.md.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mavins.filters import euler_compat, van_loan
from mavins.filters.base import FilterState, ImuNoise, Observation, Outcome, RowBlock
from mavins.filters.euler_model import (
    HELD,
    LEAST_COS,
    SINGULAR,
    acceleration,
    apparent_gravity,
    integrate_angles,
    is_singular,
    less_earth_rate,
    linearize,
    middle,
    move,
    trig,
    write_dcm,
    write_inverse_kinematics,
    write_kinematics,
)
from mavins.filters.settings import FilterSettings
from mavins.filters.van_loan import E_INV, SPARE, C, E, multiply
from mavins.filters.walking import (
    is_due,
    noise_scale,
    pieces_of,
    put_row,
    reading_at,
    reading_within,
)
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import Vector, add_walks
from mavins.nav.kernels import kernel
from mavins.nav.layout import Layout
from mavins.nav.linalg import gated_update
from mavins.nav.so3 import euler_to_quat, quat_to_euler
from mavins.types import FloatArray, IntArray

MOST_TURN: Final = 0.5
"""An interval in which roll or yaw could turn by more (rad) is cut: the dynamics are linearized over one piece."""
MOST_PIECES: Final = 100


@kernel
def pieces_to_turn(pitch: float, u: FloatArray, dt: float) -> int:
    """Into how many pieces an interval is cut because the angles turn, at the reading `u`."""
    rate = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    turn = rate * dt / max(math.cos(pitch), LEAST_COS)
    return 1 + int(min(turn / MOST_TURN, MOST_PIECES - 1.0))


@kernel
def advance(
    x: FloatArray,
    P: FloatArray,
    angles: Vector,
    w0: Vector,
    f0: Vector,
    w1: Vector,
    f1: Vector,
    h: float,
    noise: van_loan.Noise,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    work: van_loan.Workspace,
) -> Vector:
    """Move p_n, v_n and P, in place, over h between two readings joined by a line; returns the angles after it."""
    M = work[0]
    before = trig(angles)
    write_dcm(M, C, before)
    w0, w1 = less_earth_rate(M, w0, w_ie_n), less_earth_rate(M, w1, w_ie_n)
    g = apparent_gravity(x, h, r0_e, C_ne, w_ie_n)
    a0 = acceleration(M, f0, g)
    at, end = integrate_angles(angles, w0, w1, h)
    after = trig(end)
    write_dcm(M, C, after)
    a1 = acceleration(M, f1, g)
    f = middle(f0, f1)
    linearize(M, before, trig(at), after, middle(w0, w1), f)
    move(x, a0, acceleration(M, f, g), a1, h)
    van_loan.predict(P, h, noise, work)
    return end


@kernel
def step(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    row: FloatArray,
    dt_us: int,
    noise: FloatArray,
    compat: bool,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    work: van_loan.Workspace,
) -> None:
    """Move x and P, in place, from the reading `u` to the reading `row` (6,) that follows it by dt_us; u <- row.

    A state that comes too near to straight up or down is held there, so that whoever looks at it after a walk sees it.
    """
    euler = quat_to_euler(x[6:10])
    angles = (euler[0], euler[1], euler[2])
    if not is_singular(angles[1]):
        if compat:
            w, f = reading_within(x, row, row, 0.0, dt_us)
            angles = euler_compat.advance(x, P, angles, w, f, dt_us * 1e-6, noise, work)
        else:
            scale = noise_scale(dt_us)
            psd = (
                (scale * noise[0]) ** 2,
                (scale * noise[1]) ** 2,
                noise[2] ** 2,
                noise[3] ** 2,
            )
            pieces = max(pieces_of(dt_us), pieces_to_turn(angles[1], u, dt_us * 1e-6))
            h = dt_us * 1e-6 / pieces
            w0, f0 = reading_within(x, u, row, 0.0, dt_us)
            for i in range(pieces):
                w1, f1 = reading_within(x, u, row, (i + 1.0) / pieces, dt_us)
                angles = advance(x, P, angles, w0, f0, w1, f1, h, psd, r0_e, C_ne, w_ie_n, work)
                if is_singular(angles[1]):
                    break
                w0, f0 = w1, f1
        add_walks(P, noise, dt_us * 1e-6)
        pitch = angles[1]
        if is_singular(pitch):
            pitch = math.copysign(HELD, pitch)
        put_attitude(x, angles[0], pitch, angles[2])
    for i in range(6):
        u[i] = row[i]


@kernel
def put_attitude(x: FloatArray, roll: float, pitch: float, yaw: float) -> None:
    """Write Euler angles into x as its quaternion, whose scalar part is not negative."""
    q = euler_to_quat(roll, pitch, yaw)
    for i in range(4):
        x[6 + i] = q[i] if q[0] >= 0.0 else -q[i]


@kernel
def turn_attitude_error(P: FloatArray, G: FloatArray) -> None:
    """P <- T P T^T in place, exactly symmetric, with T = G (3, 3) on theta_b and the identity on the rest."""
    n = P.shape[0]
    for c in range(n):
        t0, t1, t2 = P[6, c], P[7, c], P[8, c]
        for i in range(3):
            P[6 + i, c] = G[i, 0] * t0 + G[i, 1] * t1 + G[i, 2] * t2
    for c in range(6, 9):
        t0, t1, t2 = P[c, 6], P[c, 7], P[c, 8]
        for i in range(3):
            P[c, 6 + i] = G[i, 0] * t0 + G[i, 1] * t1 + G[i, 2] * t2
    for i in range(6, 9):
        for j in range(n):
            if j < 6 or j > i:
                P[j, i] = P[i, j]


@kernel
def walk_rows(
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    start_us: int,
    t_us: IntArray,
    imu: FloatArray,
    noise: FloatArray,
    compat: bool,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    until_us: int,
    previous_us: int,
    grid_us: int,
    out_t: IntArray,
    out_x: FloatArray,
    out_u: FloatArray,
    out_P: FloatArray,
    count: int,
) -> int:
    """Walk IMU rows (see Filter.walk); returns how many output rows are filled."""
    work = van_loan.workspace(P.shape[0])
    t = start_us
    before = previous_us
    for k in range(len(t_us)):
        if t_us[k] > until_us:
            if until_us > t:
                reading = reading_at(u, imu[k], (until_us - t) / (t_us[k] - t))
                step(x, P, u, reading, until_us - t, noise, compat, r0_e, C_ne, w_ie_n, work)
            break
        step(x, P, u, imu[k], t_us[k] - t, noise, compat, r0_e, C_ne, w_ie_n, work)
        t = t_us[k]
        if is_due(t, before, grid_us):
            put_row(out_t, out_x, out_u, out_P, count, t, x, u, P)
            count += 1
        before = t
    return count


@kernel
def fuse(
    x: FloatArray,
    P: FloatArray,
    r: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
    S: FloatArray,
) -> float:
    """Gated update of P, the correction added to the angles and the rest of x; returns the NIS.

    The angles' part of the correction is E theta. Their covariance is not changed by an addition, so that of theta_b
    goes from the old E to the new one. Where the angles are singular the NIS is nan and nothing is fused.
    """
    d = np.empty(P.shape[0])
    euler = quat_to_euler(x[6:10])
    if is_singular(euler[1]):
        gated_update(P, r, H, R, columns, -1.0, d, S)
        return math.nan
    nis = gated_update(P, r, H, R, columns, gate, d, S)
    if nis <= gate:
        M = np.empty((SPARE + 1, 3, 3))
        write_kinematics(M, E, trig((euler[0], euler[1], euler[2])))
        for i in range(3):
            euler[i] += M[E, i, 0] * d[6] + M[E, i, 1] * d[7] + M[E, i, 2] * d[8]
        write_inverse_kinematics(M, E_INV, trig((euler[0], euler[1], euler[2])))
        multiply(M, SPARE, E_INV, E)
        turn_attitude_error(P, M[SPARE])
        put_attitude(x, euler[0], euler[1], euler[2])
        for i in range(len(columns)):
            c = columns[i]
            if c < 6:
                x[c] += d[i]
            elif c > 8:
                x[c + 1] += d[i]
    return nis


class EulerEkf:
    """The Euler-angle filter behind the estimator's `Filter` interface."""

    def __init__(self, noise: ImuNoise, layout: Layout, settings: FilterSettings) -> None:
        self.layout = layout
        self._noises = noise.as_arrays(layout)
        self._compat = settings.euler_ekf.compat

    def adopt(self, state: FilterState) -> None:
        """Nothing to do: the state is all that this filter has."""

    def complaint(self, state: FilterState) -> str:
        """The angles are singular straight up and down."""
        if is_singular(quat_to_euler(state.x[6:10])[1]):
            return f"pitch within {math.degrees(SINGULAR):.0f} deg of 90: Euler angles are singular"
        return ""

    def walk(
        self,
        state: FilterState,
        frame: TangentFrame,
        t_us: IntArray,
        imu: FloatArray,
        until_us: int,
        previous_us: int,
        grid_us: int,
        rows: RowBlock,
        clipped: bool = False,
    ) -> None:
        """Move through IMU rows."""
        rows.count = walk_rows(
            state.x,
            state.P,
            state.u,
            state.t_us,
            t_us,
            imu,
            self._noises[clipped],
            self._compat,
            frame.r0_e,
            frame.C_ne,
            frame.w_ie_n,
            until_us,
            previous_us,
            grid_us,
            rows.t_us,
            rows.x,
            rows.u,
            rows.P,
            rows.count,
        )
        state.t_us = until_us

    def update(self, state: FilterState, observation: Observation, gate: float) -> Outcome:
        """Fuse a measurement."""
        r, H = observation.linearize(state.x, state.u)
        S = np.empty((len(r), len(r)))
        nis = fuse(state.x, state.P, r, H, observation.R, self.layout.columns, gate, S)
        return Outcome(nis, r, S)
