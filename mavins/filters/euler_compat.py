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
    Dynamics,
    acceleration,
    angle_rates,
    linearize,
    moved,
)
from mavins.nav.ins import Vector
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
    F: Dynamics,
    work: van_loan.Workspace,
) -> Vector:
    """Move p_n, v_n and P, in place, over h at the rate w and the specific force f; returns the angles after it."""
    end = moved(angles, angle_rates(angles[0], angles[1], w), h)
    linearize(F, angles, angles, end, w, f)
    A, D, C, S, scratch = F
    a = acceleration(C, f, (0.0, 0.0, GRAVITY))
    for i in range(3):
        x[i] += h * x[3 + i]
        x[3 + i] += h * a[i]
    N, E_inv = scratch[0], scratch[1]
    van_loan.multiply_turned(N, E_inv, E_inv)
    q_g, q_a, q_bg, q_ba = noise[0] ** 2, noise[1] ** 2, noise[2] ** 2, noise[3] ** 2
    van_loan.predict(P, A, D, C, S, N, h, (q_g, q_a, 0.0, q_ba), work)
    for i in range(3):
        for j in range(3):
            N[i, j] = 1.0 if i == j else 0.0
    W, X = work[1], work[2]
    van_loan.write_noise_integrals(X, W, A, N, h, work)
    van_loan.add_noise(P, X, W, D, C, h, (0.0, 0.0, q_bg, 0.0), work)
    for i in range(3):
        P[i, i] += POSITION_NOISE**2 * h
    return end
