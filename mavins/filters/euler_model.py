"""The Euler-angle model over a flat Earth: its mechanization, and the linearized dynamics of its errors.

    (roll, pitch, yaw)' = E (w_b - b_g)
    v_n' = C_nb (f_b - b_a) + g_n
    p_n' = v_n

E(roll, pitch) is the kinematic matrix of Z-Y-X angles (so3.euler_jacobian). The Earth neither turns nor curves; its
gravity is the normal one at p_n. Source: Barton, "Fundamentals of small unmanned aircraft flight", Johns Hopkins APL
Technical Digest 31 (2012). Theory: docs/theory/euler_ekf.md.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np

from mavins.filters.van_loan import multiply
from mavins.nav.ins import Vector
from mavins.nav.kernels import kernel
from mavins.types import FloatArray

Dynamics: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""(A, D, C, S, scratch) as van_loan takes them."""

SINGULAR: Final = math.radians(3.0)
"""Nearer than this to straight up or down the angles are not used."""
HELD: Final = math.radians(89.0)
"""The pitch at which a state is held that has come there."""
LEAST_COS: Final = 0.01
"""No cosine of the pitch is taken for smaller: within one step an angle may be tried that is beyond the limit."""


@kernel
def is_singular(pitch: float) -> bool:
    """True where a pitch is too near to straight up or down, or beyond."""
    return not math.fabs(pitch) < 0.5 * math.pi - SINGULAR


@kernel
def angle_rates(roll: float, pitch: float, w: Vector) -> Vector:
    """E w: the rates of roll, pitch and yaw in rad/s at the rate w_b."""
    sr, cr = math.sin(roll), math.cos(roll)
    yaw_rate = (sr * w[1] + cr * w[2]) / max(math.cos(pitch), LEAST_COS)
    return (w[0] + math.sin(pitch) * yaw_rate, cr * w[1] - sr * w[2], yaw_rate)


@kernel
def moved(angles: Vector, rates: Vector, dt: float) -> Vector:
    """Angles that go on at these rates for dt."""
    return (
        angles[0] + dt * rates[0],
        angles[1] + dt * rates[1],
        angles[2] + dt * rates[2],
    )


@kernel
def middle(a: Vector, b: Vector) -> Vector:
    """The mean of two vectors."""
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


@kernel
def integrate_angles(angles: Vector, w0: Vector, w1: Vector, dt: float) -> tuple[Vector, Vector]:
    """The angles after dt/2 and after dt of a rate that goes linearly from w0 to w1 (Runge and Kutta's 4th order)."""
    wm = middle(w0, w1)
    k1 = angle_rates(angles[0], angles[1], w0)
    a = moved(angles, k1, 0.5 * dt)
    k2 = angle_rates(a[0], a[1], wm)
    a = moved(angles, k2, 0.5 * dt)
    k3 = angle_rates(a[0], a[1], wm)
    a = moved(angles, k3, dt)
    k4 = angle_rates(a[0], a[1], w1)
    k = (
        (k1[0] + 2.0 * (k2[0] + k3[0]) + k4[0]) / 6.0,
        (k1[1] + 2.0 * (k2[1] + k3[1]) + k4[1]) / 6.0,
        (k1[2] + 2.0 * (k2[2] + k3[2]) + k4[2]) / 6.0,
    )
    end = moved(angles, k, dt)
    # Hermite's cubic through both ends
    bend = (k1[0] - k4[0], k1[1] - k4[1], k1[2] - k4[2])
    return moved(middle(angles, end), bend, 0.125 * dt), end


@kernel
def write_dcm(C: FloatArray, angles: Vector) -> None:
    """C <- C_nb (3, 3) of Z-Y-X Euler angles."""
    sr, cr = math.sin(angles[0]), math.cos(angles[0])
    sp, cp = math.sin(angles[1]), math.cos(angles[1])
    sy, cy = math.sin(angles[2]), math.cos(angles[2])
    C[0, 0] = cp * cy
    C[0, 1] = sr * sp * cy - cr * sy
    C[0, 2] = cr * sp * cy + sr * sy
    C[1, 0] = cp * sy
    C[1, 1] = sr * sp * sy + cr * cy
    C[1, 2] = cr * sp * sy - sr * cy
    C[2, 0] = -sp
    C[2, 1] = sr * cp
    C[2, 2] = cr * cp


@kernel
def acceleration(C: FloatArray, f: Vector, g: Vector) -> Vector:
    """v_n' = C f_b + g_n in m/s^2."""
    return (
        C[0, 0] * f[0] + C[0, 1] * f[1] + C[0, 2] * f[2] + g[0],
        C[1, 0] * f[0] + C[1, 1] * f[1] + C[1, 2] * f[2] + g[1],
        C[2, 0] * f[0] + C[2, 1] * f[1] + C[2, 2] * f[2] + g[2],
    )


@kernel
def move(x: FloatArray, a0: Vector, am: Vector, a1: Vector, dt: float) -> None:
    """p_n and v_n of x go on by accelerations at the start, the middle and the end of dt (Simpson's rule)."""
    for i in range(3):
        x[i] += dt * x[3 + i] + dt * dt / 6.0 * (a0[i] + 2.0 * am[i])
        x[3 + i] += dt / 6.0 * (a0[i] + 4.0 * am[i] + a1[i])


@kernel
def write_angle_dynamics(M: FloatArray, roll: float, pitch: float, w: Vector) -> None:
    """M <- d(E w) / d(roll, pitch, yaw) (3, 3), in 1/s."""
    sr, cr = math.sin(roll), math.cos(roll)
    sec = 1.0 / max(math.cos(pitch), LEAST_COS)
    tan = math.sin(pitch) * sec
    along = cr * w[1] - sr * w[2]
    across = sr * w[1] + cr * w[2]
    M[0, 0] = tan * along
    M[0, 1] = sec * sec * across
    M[1, 0] = -across
    M[1, 1] = 0.0
    M[2, 0] = sec * along
    M[2, 1] = sec * tan * across
    for i in range(3):
        M[i, 2] = 0.0


@kernel
def write_kinematics(E: FloatArray, E_inv: FloatArray, roll: float, pitch: float) -> None:
    """E <- the kinematic matrix d(roll, pitch, yaw) / d theta_b (3, 3), E_inv <- its inverse."""
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    sec = 1.0 / max(cp, LEAST_COS)
    E[0, 0] = 1.0
    E[0, 1] = sr * sp * sec
    E[0, 2] = cr * sp * sec
    E[1, 0] = 0.0
    E[1, 1] = cr
    E[1, 2] = -sr
    E[2, 0] = 0.0
    E[2, 1] = sr * sec
    E[2, 2] = cr * sec
    E_inv[0, 0] = 1.0
    E_inv[0, 1] = 0.0
    E_inv[0, 2] = -sp
    E_inv[1, 0] = 0.0
    E_inv[1, 1] = cr
    E_inv[1, 2] = sr * cp
    E_inv[2, 0] = 0.0
    E_inv[2, 1] = -sr
    E_inv[2, 2] = cr * cp


@kernel
def write_force_dynamics(B: FloatArray, C: FloatArray, f: Vector) -> None:
    """B <- d(C_nb f_b) / d theta_b = -C_nb [f_b]x (3, 3), in m/s^2."""
    for i in range(3):
        B[i, 0] = C[i, 2] * f[1] - C[i, 1] * f[2]
        B[i, 1] = C[i, 0] * f[2] - C[i, 2] * f[0]
        B[i, 2] = C[i, 1] * f[0] - C[i, 0] * f[1]


@kernel
def dynamics() -> Dynamics:
    """Room for the dynamics of the errors."""
    return (
        np.empty((3, 3)),
        np.empty((3, 3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((4, 3, 3)),
    )


@kernel
def linearize(
    F: Dynamics, start: Vector, at: Vector, end: Vector, w: Vector, f: Vector
) -> None:
    """Fill F: the error dynamics at the angles `at`, rate w and specific force f of an interval.

    They are those of the angles, in the coordinates theta = E^-1 d(roll, pitch, yaw) with E taken at `at`: there
    A = E^-1 M E, and gyro noise and bias enter alike on all axes. S and D[2] lead from theta_b at the start of the
    interval into them, and from them to theta_b at its end.
    """
    A, D, C, S, scratch = F
    E, E_inv, other, unused = scratch[0], scratch[1], scratch[2], scratch[3]
    write_dcm(C, at)
    write_force_dynamics(D[0], C, f)
    write_force_dynamics(D[1], C, f)
    write_kinematics(other, unused, start[0], start[1])
    write_kinematics(E, E_inv, at[0], at[1])
    multiply(S, E_inv, other)
    write_angle_dynamics(A, at[0], at[1], w)
    multiply(other, A, E)
    multiply(A, E_inv, other)
    write_kinematics(unused, other, end[0], end[1])
    multiply(D[2], other, E)
