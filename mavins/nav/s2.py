"""The direction of gravity as a point on the sphere S2: its deviation from normal gravity, with two error states.

    g = T(t) g_n(p),   T(t) = Exp((t_n, t_e, 0)),   u = T e_d

Normal gravity g_n(p) of earth.py is turned as the down axis e_d of n is turned into the unit vector u, by the shortest
way: a rotation vector t = (t_n, t_e) without a part about e_d, zero where gravity is normal. An error d lies in the
plane across u, on the basis B(u) = T [e_n e_e]:

    u [+] d = Exp(B d) u = T Exp((d_n, d_e, 0)) e_d,   u_1 [-] u_0 = the d with u_0 [+] d = u_1

Sources: Hertzberg, Wagner, Frese and Schroeder (2011) for boxplus on spheres; He, Xu and Zhang (2021) for a basis and
its Jacobians. Theory: docs/theory/error_state.md.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from mavins.nav.kernels import kernel
from mavins.nav.so3 import SMALL, Quaternion, exponential, logarithm, product
from mavins.types import FloatArray

Pair: TypeAlias = tuple[float, float]
Vector: TypeAlias = tuple[float, float, float]


@kernel
def without_twist(q: Quaternion) -> Pair:
    """The t (2) whose T(t) takes e_d to where the rotation q takes it."""
    n = math.sqrt(q[0] * q[0] + q[3] * q[3])
    log = logarithm(product(q, (q[0] / n, 0.0, 0.0, -q[3] / n)))
    return (log[0], log[1])


@kernel
def moved(t: Pair, d0: float, d1: float) -> Pair:
    """The t of u [+] d."""
    return without_twist(product(exponential(t[0], t[1], 0.0), exponential(d0, d1, 0.0)))


@kernel
def difference(t1: Pair, t0: Pair) -> Pair:
    """u_1 [-] u_0."""
    return without_twist(product(exponential(-t0[0], -t0[1], 0.0), exponential(t1[0], t1[1], 0.0)))


@kernel
def tilted(t: Pair, g: Vector) -> Vector:
    """T(t) g."""
    w, x, y, _ = exponential(t[0], t[1], 0.0)
    # v + 2 w (a x v) + 2 a x (a x v) with a = (x, y, 0)
    c0, c1, c2 = y * g[2], -x * g[2], x * g[1] - y * g[0]
    return (
        g[0] + 2.0 * (w * c0 + y * c2),
        g[1] + 2.0 * (w * c1 - x * c2),
        g[2] + 2.0 * (w * c2 + x * c1 - y * c0),
    )


@kernel
def write_gravity_jacobian(K: FloatArray, t: Pair, g: Vector) -> None:
    """K (3, 2) <- d g / d d = -[g]x T J for g = T(t) g_n, with J (3, 2) the turn of T by d.

    J is the identity over a last row tan(a/2)/a (t_e, -t_n), a = |t|: as u moves by d, T must turn about e_d besides,
    to stay the shortest way.
    """
    a2 = t[0] * t[0] + t[1] * t[1]
    a = math.sqrt(a2)
    k = 0.5 + a2 / 24.0 if a2 < SMALL else math.tan(0.5 * a) / a
    for j in range(2):
        J = (1.0, 0.0, k * t[1]) if j == 0 else (0.0, 1.0, -k * t[0])
        c0, c1, c2 = tilted(t, J)
        K[0, j] = g[2] * c1 - g[1] * c2
        K[1, j] = g[0] * c2 - g[2] * c0
        K[2, j] = g[1] * c0 - g[0] * c1


@kernel
def write_step_jacobian(G: FloatArray, t: Pair, d0: float, d1: float) -> None:
    """The upper left (2, 2) of G <- the derivative by e of (u [+] (d + e)) [-] (u [+] d), at e = 0.

    Jr(d) across e_d, turned by how much B(u [+] d) is turned from T Exp(d) [e_n e_e].
    """
    q = product(exponential(t[0], t[1], 0.0), exponential(d0, d1, 0.0))
    n = math.sqrt(q[0] * q[0] + q[3] * q[3])
    c, s = q[0] / n, q[3] / n
    c, s = c * c - s * s, 2.0 * c * s
    a2 = d0 * d0 + d1 * d1
    a = math.sqrt(a2)
    k = (1.0 - a2 / 20.0) / 6.0 if a2 < SMALL else (a - math.sin(a)) / (a * a2)
    m00, m01, m11 = 1.0 - k * d1 * d1, k * d0 * d1, 1.0 - k * d0 * d0
    G[0, 0], G[0, 1] = c * m00 - s * m01, c * m01 - s * m11
    G[1, 0], G[1, 1] = s * m00 + c * m01, s * m01 + c * m11
