"""The invariant extended Kalman filter on SE_2(3), with additive biases ("imperfect" IEKF).

The error is a group element that multiplies the state from the left, chi_true = Exp(xi) chi, with xi = (rho, nu, phi)
over (p_n, v_n, C_nb) in the axes of n. To first order the canonical errors are

    dp = rho - [p_n]x phi,   dv = nu - [v_n]x phi,   theta_b = C_bn phi

Sources: Barrau and Bonnabel, "The Invariant Extended Kalman Filter as a Stable Observer" (2017); Hartley, Ghaffari,
Eustice and Grizzle, "Contact-aided invariant extended Kalman filtering for robot state estimation" (2020), for the
biases; Goffin et al., "Iterated invariant extended Kalman filter" (2024). Theory: docs/theory/iekf.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.filters.iterated import J_L, J_R, N_P, N_V, Iterated, write_gravity_block
from mavins.nav.ins import Vector
from mavins.nav.kernels import kernel
from mavins.nav.layout import boxplus
from mavins.nav.so3 import SMALL, write_dcm, write_right_jacobian
from mavins.types import FloatArray, IntArray


@kernel
def write_bend(N: FloatArray, phi: Vector, d: FloatArray, first: int) -> None:
    """N (3, 3) <- the derivative of Jl(phi) u by phi, for u = d[first : first + 3].

    Jl(phi) u = u + c1 phi x u + c2 phi x (phi x u), with c1 and c2 of `so3.write_right_jacobian`.
    """
    x, y, z = phi
    u0, u1, u2 = d[first], d[first + 1], d[first + 2]
    a2 = x * x + y * y + z * z
    # k1, k2: the derivatives of c1 and c2 by a, over a
    if a2 < SMALL:
        c1 = 0.5 - a2 * (1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 / 40320.0))
        c2 = 1.0 / 6.0 - a2 * (1.0 / 120.0 - a2 * (1.0 / 5040.0 - a2 / 362880.0))
        k1 = -1.0 / 12.0 + a2 * (1.0 / 180.0 - a2 * (1.0 / 6720.0 - a2 / 453600.0))
        k2 = -1.0 / 60.0 + a2 * (1.0 / 1260.0 - a2 * (1.0 / 60480.0 - a2 / 4989600.0))
    else:
        a = math.sqrt(a2)
        s, c = math.sin(a), math.cos(a)
        c1 = (1.0 - c) / a2
        c2 = (a - s) / (a2 * a)
        k1 = (a * s - 2.0 * (1.0 - c)) / (a2 * a2)
        k2 = (3.0 * s - a * c - 2.0 * a) / (a2 * a2 * a)
    # once = phi x u, twice = phi x (phi x u)
    o0, o1, o2 = y * u2 - z * u1, z * u0 - x * u2, x * u1 - y * u0
    t0, t1, t2 = y * o2 - z * o1, z * o0 - x * o2, x * o1 - y * o0
    along = x * u0 + y * u1 + z * u2
    m0, m1, m2 = k1 * o0 + k2 * t0, k1 * o1 + k2 * t1, k1 * o2 + k2 * t2
    # -c1 [u]x - c2 ([once]x + [phi]x [u]x) + (k1 once + k2 twice) phi^T, with [phi]x [u]x = u phi^T - (phi.u) I
    s0, s1, s2 = c1 * u0 + c2 * o0, c1 * u1 + c2 * o1, c1 * u2 + c2 * o2
    m0, m1, m2 = m0 - c2 * u0, m1 - c2 * u1, m2 - c2 * u2
    N[0, 0] = c2 * along + m0 * x
    N[0, 1] = s2 + m0 * y
    N[0, 2] = -s1 + m0 * z
    N[1, 0] = -s2 + m1 * x
    N[1, 1] = c2 * along + m1 * y
    N[1, 2] = s0 + m1 * z
    N[2, 0] = s1 + m2 * x
    N[2, 1] = -s0 + m2 * y
    N[2, 2] = c2 * along + m2 * z


@kernel
def group_step(x: FloatArray, s: FloatArray, columns: IntArray, G: FloatArray) -> None:
    """X <- Exp(xi) x for the correction s (n,) over canonical errors; G <- its derivative by s.

    With phi = C_nb theta_b and rho = dp + [p]x phi, Exp(phi) p + Jl(phi) rho = p + Jl(phi) dp: the place of the origin
    cancels, and v likewise.
    """
    C, T, d = np.empty((3, 3)), np.empty((3, 3)), s.copy()
    write_dcm(C, (x[6], x[7], x[8], x[9]))
    phi = (
        C[0, 0] * d[6] + C[0, 1] * d[7] + C[0, 2] * d[8],
        C[1, 0] * d[6] + C[1, 1] * d[7] + C[1, 2] * d[8],
        C[2, 0] * d[6] + C[2, 1] * d[7] + C[2, 2] * d[8],
    )
    # Jl(phi) = Jr(-phi)
    write_right_jacobian(G[J_L], -phi[0], -phi[1], -phi[2])
    write_right_jacobian(G[J_R], d[6], d[7], d[8])
    for block, first in ((N_P, 0), (N_V, 3)):
        write_bend(T, phi, d, first)
        d0, d1, d2 = d[first], d[first + 1], d[first + 2]
        for i in range(3):
            d[first + i] = G[J_L, i, 0] * d0 + G[J_L, i, 1] * d1 + G[J_L, i, 2] * d2
            for j in range(3):
                G[block, i, j] = T[i, 0] * C[0, j] + T[i, 1] * C[1, j] + T[i, 2] * C[2, j]
    write_gravity_block(G, x, s)
    boxplus(x, d, columns)


class Iekf(Iterated):
    """The invariant filter behind the estimator's `Filter` interface.

    Propagating the invariant error's covariance and turning it into the canonical one, T P T^T, is the same linear map
    as propagating the canonical one: the walk is the error-state filter's. What an update does to the state, and to the
    covariance on the way, is what makes the two filters differ.
    """

    step = staticmethod(group_step)
