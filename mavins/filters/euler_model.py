"""The Euler-angle model over a flat Earth: its mechanization, and the linearized dynamics of its errors.

    (roll, pitch, yaw)' = E (w_b - b_g - C_bn w_ie_n)
    v_n' = C_nb (f_b - b_a) + g_n - 2 w_ie_n x v_n
    p_n' = v_n

E(roll, pitch) is the kinematic matrix of Z-Y-X angles (so3.euler_jacobian). The Earth's rotation is taken off as it is
at the start of an interval, and is not in the dynamics of the errors; neither is the gradient of gravity. Source:
Barton, "Fundamentals of small unmanned aircraft flight", Johns Hopkins APL Technical Digest 31 (2012).
Theory: docs/theory/euler_ekf.md.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from mavins.filters.van_loan import AFTER, BEFORE, E_INV, SPARE, A, B, C, E, multiply
from mavins.nav.earth import gravity_at
from mavins.nav.ins import Vector
from mavins.nav.kernels import kernel
from mavins.types import FloatArray

Trig: TypeAlias = tuple[float, float, float, float, float, float]
"""Sine and cosine of roll, of pitch and of yaw."""

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
def trig(angles: Vector) -> Trig:
    """What the matrices below are made of."""
    return (
        math.sin(angles[0]),
        math.cos(angles[0]),
        math.sin(angles[1]),
        math.cos(angles[1]),
        math.sin(angles[2]),
        math.cos(angles[2]),
    )


@kernel
def write_dcm(M: FloatArray, at: int, a: Trig) -> None:
    """M[at] <- C_nb of Z-Y-X Euler angles."""
    sr, cr, sp, cp, sy, cy = a
    M[at, 0, 0] = cp * cy
    M[at, 0, 1] = sr * sp * cy - cr * sy
    M[at, 0, 2] = cr * sp * cy + sr * sy
    M[at, 1, 0] = cp * sy
    M[at, 1, 1] = sr * sp * sy + cr * cy
    M[at, 1, 2] = cr * sp * sy - sr * cy
    M[at, 2, 0] = -sp
    M[at, 2, 1] = sr * cp
    M[at, 2, 2] = cr * cp


@kernel
def acceleration(M: FloatArray, f: Vector, g: Vector) -> Vector:
    """v_n' = C f_b + g_n in m/s^2, with C in its place in the stack."""
    return (
        M[C, 0, 0] * f[0] + M[C, 0, 1] * f[1] + M[C, 0, 2] * f[2] + g[0],
        M[C, 1, 0] * f[0] + M[C, 1, 1] * f[1] + M[C, 1, 2] * f[2] + g[1],
        M[C, 2, 0] * f[0] + M[C, 2, 1] * f[1] + M[C, 2, 2] * f[2] + g[2],
    )


@kernel
def less_earth_rate(M: FloatArray, w: Vector, w_ie_n: FloatArray) -> Vector:
    """w_b - C_bn w_ie_n: the rate of b against n, with C_nb in its place in the stack."""
    return (
        w[0] - (M[C, 0, 0] * w_ie_n[0] + M[C, 1, 0] * w_ie_n[1] + M[C, 2, 0] * w_ie_n[2]),
        w[1] - (M[C, 0, 1] * w_ie_n[0] + M[C, 1, 1] * w_ie_n[1] + M[C, 2, 1] * w_ie_n[2]),
        w[2] - (M[C, 0, 2] * w_ie_n[0] + M[C, 1, 2] * w_ie_n[1] + M[C, 2, 2] * w_ie_n[2]),
    )


@kernel
def apparent_gravity(
    x: FloatArray, h: float, r0_e: FloatArray, C_ne: FloatArray, w_ie_n: FloatArray
) -> Vector:
    """g_n - 2 w_ie_n x v_n in m/s^2, where x has come to in the middle of an interval h at its speed."""
    v0, v1, v2 = x[3], x[4], x[5]
    g = gravity_at(x[0] + 0.5 * h * v0, x[1] + 0.5 * h * v1, x[2] + 0.5 * h * v2, r0_e, C_ne)
    return (
        g[0] - 2.0 * (w_ie_n[1] * v2 - w_ie_n[2] * v1),
        g[1] - 2.0 * (w_ie_n[2] * v0 - w_ie_n[0] * v2),
        g[2] - 2.0 * (w_ie_n[0] * v1 - w_ie_n[1] * v0),
    )


@kernel
def move(x: FloatArray, a0: Vector, am: Vector, a1: Vector, dt: float) -> None:
    """p_n and v_n of x go on by accelerations at the start, the middle and the end of dt (Simpson's rule)."""
    for i in range(3):
        x[i] += dt * x[3 + i] + dt * dt / 6.0 * (a0[i] + 2.0 * am[i])
        x[3 + i] += dt / 6.0 * (a0[i] + 4.0 * am[i] + a1[i])


@kernel
def write_angle_dynamics(M: FloatArray, at: int, a: Trig, w: Vector) -> None:
    """M[at] <- d(E w) / d(roll, pitch, yaw), in 1/s."""
    sr, cr, sp, cp, _, _ = a
    sec = 1.0 / max(cp, LEAST_COS)
    tan = sp * sec
    along = cr * w[1] - sr * w[2]
    across = sr * w[1] + cr * w[2]
    M[at, 0, 0] = tan * along
    M[at, 0, 1] = sec * sec * across
    M[at, 1, 0] = -across
    M[at, 1, 1] = 0.0
    M[at, 2, 0] = sec * along
    M[at, 2, 1] = sec * tan * across
    for i in range(3):
        M[at, i, 2] = 0.0


@kernel
def write_kinematics(M: FloatArray, at: int, a: Trig) -> None:
    """M[at] <- E = d(roll, pitch, yaw) / d theta_b."""
    sr, cr, sp, cp, _, _ = a
    sec = 1.0 / max(cp, LEAST_COS)
    M[at, 0, 0] = 1.0
    M[at, 0, 1] = sr * sp * sec
    M[at, 0, 2] = cr * sp * sec
    M[at, 1, 0] = 0.0
    M[at, 1, 1] = cr
    M[at, 1, 2] = -sr
    M[at, 2, 0] = 0.0
    M[at, 2, 1] = sr * sec
    M[at, 2, 2] = cr * sec


@kernel
def write_inverse_kinematics(M: FloatArray, at: int, a: Trig) -> None:
    """M[at] <- E^-1 = d theta_b / d(roll, pitch, yaw)."""
    sr, cr, sp, cp, _, _ = a
    M[at, 0, 0] = 1.0
    M[at, 0, 1] = 0.0
    M[at, 0, 2] = -sp
    M[at, 1, 0] = 0.0
    M[at, 1, 1] = cr
    M[at, 1, 2] = sr * cp
    M[at, 2, 0] = 0.0
    M[at, 2, 1] = -sr
    M[at, 2, 2] = cr * cp


@kernel
def write_force_dynamics(M: FloatArray, at: int, f: Vector) -> None:
    """M[at] <- d(C_nb f_b) / d theta_b = -C_nb [f_b]x, in m/s^2, with C in its place in the stack."""
    for i in range(3):
        M[at, i, 0] = M[C, i, 2] * f[1] - M[C, i, 1] * f[2]
        M[at, i, 1] = M[C, i, 0] * f[2] - M[C, i, 2] * f[0]
        M[at, i, 2] = M[C, i, 1] * f[0] - M[C, i, 0] * f[1]


@kernel
def linearize(M: FloatArray, start: Trig, at: Trig, end: Trig, w: Vector, f: Vector) -> None:
    """Fill a stack with the error dynamics at the angles `at`, rate w and specific force f of an interval.

    They are those of the angles, in the coordinates theta = E^-1 d(roll, pitch, yaw) with E taken at `at`: there
    A = E^-1 d(E w)/d(angles) E, and the gyro's noise and bias are on the body's axes. BEFORE leads from theta_b at the
    start of the interval into them, AFTER from them to theta_b at its end.
    """
    write_dcm(M, C, at)
    write_force_dynamics(M, B, f)
    write_inverse_kinematics(M, E_INV, at)
    write_kinematics(M, E, start)
    multiply(M, BEFORE, E_INV, E)
    write_kinematics(M, E, at)
    write_angle_dynamics(M, AFTER, at, w)
    multiply(M, SPARE, AFTER, E)
    multiply(M, A, E_INV, SPARE)
    write_inverse_kinematics(M, E_INV, end)
    multiply(M, AFTER, E_INV, E)
