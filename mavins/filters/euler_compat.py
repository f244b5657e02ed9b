"""The step of the original: Euler's forward rule, with its noises on the angles and the position.

What differs from the step of `euler_ekf`: the reading that ends an interval is held over all of it, everything is
linearized where the interval starts, gravity is 9.81 m/s^2, the attitude's noise is on roll, pitch and yaw alike (not
on the body's axes), and the position has a noise of its own. Source: Barton (2012), as published with the article
that the example square-spiral reproduces. Theory: docs/theory/euler_ekf.md.
"""

from __future__ import annotations

from typing import Final

from mavins.filters import van_loan
from mavins.filters.euler_model import (
    Trig,
    acceleration,
    angle_rates,
    linearize,
    moved,
    trig,
    write_angle_dynamics,
    write_inverse_kinematics,
)
from mavins.filters.van_loan import AFTER, E_INV, A, B, E, multiply
from mavins.nav.ins import MOVING, Vector
from mavins.nav.kernels import kernel
from mavins.types import FloatArray

GRAVITY: Final = 9.81
POSITION_NOISE: Final = 0.005
"""Root PSD of the position's own noise, m/sqrt(s)."""


@kernel
def advance(
    x: FloatArray,
    P: FloatArray,
    angles: Vector,
    w: Vector,
    f: Vector,
    h: float,
    noise: FloatArray,
    work: van_loan.Workspace,
) -> Vector:
    """Move p_n, v_n and P, in place, over h at the rate w and the specific force f; returns the angles after it."""
    M = work[0]
    end = moved(angles, angle_rates(angles[0], angles[1], w), h)
    at = trig(angles)
    linearize(M, at, at, trig(end), w, f)
    a = acceleration(M, f, (0.0, 0.0, GRAVITY))
    for i in range(3):
        x[i] += h * x[3 + i]
        x[3 + i] += h * a[i]
    q_angles, q_a, q_bg, q_ba = noise[0] ** 2, noise[1] ** 2, noise[2] ** 2, noise[3] ** 2
    van_loan.predict(P, h, (0.0, q_a, q_bg, q_ba), work)
    add_angle_noise(P, work, at, trig(end), w, h, q_angles)
    for i in range(3):
        P[i, i] += POSITION_NOISE**2 * h
    return end


@kernel
def add_angle_noise(
    P: FloatArray,
    work: van_loan.Workspace,
    at: Trig,
    end: Trig,
    w: Vector,
    h: float,
    q: float,
) -> None:
    """P <- P + the part of Q that comes of noise on the angles, of PSD q: on roll, pitch and yaw it is the same.

    The errors of the angles are taken as they are for this; B and AFTER lead from them, by E^-1, to the canonical ones.
    """
    M, _, _, _, block, c = work
    write_angle_dynamics(M, A, at, w)
    write_inverse_kinematics(M, E_INV, at)
    multiply(M, E, B, E_INV)
    for i in range(3):
        for j in range(3):
            M[B, i, j] = M[E, i, j]
    write_inverse_kinematics(M, AFTER, end)
    van_loan.write_exponential_integrals(M, h)
    van_loan.write_noise_integrals(M, h, q, 0.0, c)
    for i in range(MOVING):
        for j in range(i + 1):
            block[i, j] = 0.0
    van_loan.add_noise(block, M, h, (q, 0.0, 0.0, 0.0))
    for i in range(MOVING):
        for j in range(i + 1):
            P[i, j] += block[i, j]
            P[j, i] = P[i, j]
