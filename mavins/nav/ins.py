"""The strapdown mechanization in frame n and its error dynamics: one model for all error-state filters.

    p' = v
    v' = C_nb (f_b - b_a) + g_n(p) - 2 w_ie_n x v
    C' = C_nb [w_b - b_g]x - [w_ie_n]x C_nb

An interval enters as a rotation vector `phi` and a velocity increment `dv`, both in the body frame at the
interval's start, with the coning and sculling terms already in them. Errors are canonical (layout.py).
Where gravity's direction is estimated, g_n(p) is normal gravity turned by the state's deviation (s2.py).
Sources: Savage, "Strapdown Inertial Navigation Integration Algorithm Design" (1998), parts 1 and 2; Sola
(2017), section 5. Theory: docs/theory/mechanization.md.

The kernels are written out in scalars and write into arrays they are given: one interval at IMU rate costs
about as much as ten small memory allocations would.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from mavins.nav.earth import gravity_at, write_gravity_gradient
from mavins.nav.kernels import kernel
from mavins.nav.s2 import tilted, write_gravity_jacobian
from mavins.nav.so3 import exponential, product, write_dcm, write_right_jacobian
from mavins.types import FloatArray

Vector: TypeAlias = tuple[float, float, float]
Workspace: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


@kernel
def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def increments_from_rates(
    w0: Vector, f0: Vector, w1: Vector, f1: Vector, dt: float
) -> tuple[Vector, Vector]:
    """(phi, dv) over an interval between two point samples, rate and specific force linear in between.

    phi = W + w0 x w1 dt^2/12 (coning) and dv = F + W x F / 2 + W x (W x F) / 6 + (w0 x f1 + f0 x w1) dt^2/12
    (rotation to third order, sculling) with W = (w0 + w1) dt/2 and F = (f0 + f1) dt/2. rad/s and m/s^2 in, rad and
    m/s out; for smooth signals the error falls as dt^2.
    """
    h = 0.5 * dt
    k = dt * dt / 12.0
    W = ((w0[0] + w1[0]) * h, (w0[1] + w1[1]) * h, (w0[2] + w1[2]) * h)
    F = ((f0[0] + f1[0]) * h, (f0[1] + f1[1]) * h, (f0[2] + f1[2]) * h)
    coning = _cross(w0, w1)
    rotation = _cross(W, F)
    twice = _cross(W, rotation)
    s1 = _cross(w0, f1)
    s2 = _cross(f0, w1)
    phi = (W[0] + k * coning[0], W[1] + k * coning[1], W[2] + k * coning[2])
    dv = (
        F[0] + 0.5 * rotation[0] + twice[0] / 6.0 + k * (s1[0] + s2[0]),
        F[1] + 0.5 * rotation[1] + twice[1] / 6.0 + k * (s1[1] + s2[1]),
        F[2] + 0.5 * rotation[2] + twice[2] / 6.0 + k * (s1[2] + s2[2]),
    )
    return phi, dv


@kernel
def increments_from_integrals(
    a0: Vector, s0: Vector, a1: Vector, s1: Vector
) -> tuple[Vector, Vector]:
    """(phi, dv) over an interval from its integrals `a1` of the rate and `s1` of the specific force.

    `a0`, `s0` are the integrals over the interval before, of the same length: phi = a1 + a0 x a1 / 12,
    dv = s1 + a1 x s1 / 2 + a1 x (a1 x s1) / 6 + (a0 x s1 + s0 x a1) / 12
    (Savage 1998, one sample with the one before it).
    """
    coning = _cross(a0, a1)
    rotation = _cross(a1, s1)
    twice = _cross(a1, rotation)
    c1 = _cross(a0, s1)
    c2 = _cross(s0, a1)
    phi = (a1[0] + coning[0] / 12.0, a1[1] + coning[1] / 12.0, a1[2] + coning[2] / 12.0)
    dv = (
        s1[0] + 0.5 * rotation[0] + twice[0] / 6.0 + (c1[0] + c2[0]) / 12.0,
        s1[1] + 0.5 * rotation[1] + twice[1] / 6.0 + (c1[1] + c2[1]) / 12.0,
        s1[2] + 0.5 * rotation[2] + twice[2] / 6.0 + (c1[2] + c2[2]) / 12.0,
    )
    return phi, dv


@kernel
def mechanize(
    x: FloatArray,
    phi: Vector,
    dv: Vector,
    dt: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    C: FloatArray,
) -> Vector:
    """Move the nominal state `x` over one interval, in place; C <- C_nb at its start; returns g_n at its middle.

    q <- Exp(-w_ie dt) (x) q (x) Exp(phi); v <- v + (I - [w_ie dt/2]x) C_nb dv + (g_n - 2 w_ie x v) dt with g_n and
    the Coriolis term at mid-interval; p by the trapezoid of v.
    """
    q = (x[6], x[7], x[8], x[9])
    write_dcm(C, q)
    h = 0.5 * dt
    w = (w_ie_n[0], w_ie_n[1], w_ie_n[2])
    v = (x[3], x[4], x[5])
    g = gravity_at(x[0] + h * v[0], x[1] + h * v[1], x[2] + h * v[2], r0_e, C_ne)
    if x[24] != 0.0 or x[25] != 0.0:
        g = tilted((x[24], x[25]), g)
    u0 = C[0, 0] * dv[0] + C[0, 1] * dv[1] + C[0, 2] * dv[2]
    u1 = C[1, 0] * dv[0] + C[1, 1] * dv[1] + C[1, 2] * dv[2]
    u2 = C[2, 0] * dv[0] + C[2, 1] * dv[1] + C[2, 2] * dv[2]
    # (dt/2) u turns with the Earth during the interval, 2 dt v_mid is the Coriolis term
    turned = _cross(
        w,
        (
            h * u0 + 2.0 * dt * (v[0] + 0.5 * (u0 + g[0] * dt)),
            h * u1 + 2.0 * dt * (v[1] + 0.5 * (u1 + g[1] * dt)),
            h * u2 + 2.0 * dt * (v[2] + 0.5 * (u2 + g[2] * dt)),
        ),
    )
    d = (u0 + g[0] * dt - turned[0], u1 + g[1] * dt - turned[1], u2 + g[2] * dt - turned[2])
    x[0] += dt * (v[0] + 0.5 * d[0])
    x[1] += dt * (v[1] + 0.5 * d[1])
    x[2] += dt * (v[2] + 0.5 * d[2])
    x[3] += d[0]
    x[4] += d[1]
    x[5] += d[2]
    q = product(q, exponential(phi[0], phi[1], phi[2]))
    q = product(exponential(-dt * w[0], -dt * w[1], -dt * w[2]), q)
    # one Newton step of 1/|q| keeps a nearly unit quaternion at unit length to rounding
    s = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    x[6] = s * q[0]
    x[7] = s * q[1]
    x[8] = s * q[2]
    x[9] = s * q[3]
    return g


BLOCKS = 5
V_V, V_P, V_T, T_T, T_G = range(BLOCKS)
"""Places of the transition's 3x3 blocks: d v / d v, d v / d p, d v / d theta, d theta / d theta, d theta / d b_g."""


@kernel
def transition(
    A: FloatArray, C: FloatArray, g: Vector, phi: Vector, dv: Vector, dt: float, w_ie_n: FloatArray
) -> None:
    """Write the blocks of Phi = d(error after) / d(error before) over one interval into A (5, 3, 3).

    d v / d v = I - 2 [w_ie]x dt, d v / d p = gravity gradient dt, d v / d theta = -C [dv]x,
    d theta / d theta = Exp(phi)^T, d theta / d b_g = -Jr(phi) dt. The rest follows from these: d v / d b_a = -C dt,
    d v / d b_g = C [dv]x dt / 2, d p after = d p + dt/2 (d v before + d v after).
    """
    for i in range(3):
        for j in range(3):
            A[V_V, i, j] = 1.0 if i == j else 0.0
    A[V_V, 0, 1] += 2.0 * dt * w_ie_n[2]
    A[V_V, 0, 2] -= 2.0 * dt * w_ie_n[1]
    A[V_V, 1, 0] -= 2.0 * dt * w_ie_n[2]
    A[V_V, 1, 2] += 2.0 * dt * w_ie_n[0]
    A[V_V, 2, 0] += 2.0 * dt * w_ie_n[1]
    A[V_V, 2, 1] -= 2.0 * dt * w_ie_n[0]
    write_gravity_gradient(A[V_P], g[0], g[1], g[2])
    write_dcm(A[T_T], exponential(-phi[0], -phi[1], -phi[2]))
    write_right_jacobian(A[T_G], phi[0], phi[1], phi[2])
    for i in range(3):
        A[V_T, i, 0] = C[i, 2] * dv[1] - C[i, 1] * dv[2]
        A[V_T, i, 1] = C[i, 0] * dv[2] - C[i, 2] * dv[0]
        A[V_T, i, 2] = C[i, 1] * dv[0] - C[i, 0] * dv[1]
        for j in range(3):
            A[V_P, i, j] *= dt
            A[T_G, i, j] *= -dt


MOVING = 9
"""The first error states, p_n, v_n and theta_b, are the ones that a transition changes."""
CORE_SIZE = 15


@kernel
def apply_transition(
    M: FloatArray,
    A: FloatArray,
    C: FloatArray,
    dt: float,
    out: FloatArray,
    n_p: int,
    n_v: int,
    n_t: int,
) -> None:
    """Out (9, k) <- the moving rows of Phi M for M (n, k), whose first 15 rows are the core errors.

    Of the rows of p_n, v_n and theta_b only the first n_p <= n_v, n_v and n_t columns are found.
    """
    h = 0.5 * dt
    for i in range(3):
        vv0, vv1, vv2 = A[V_V, i, 0], A[V_V, i, 1], A[V_V, i, 2]
        vp0, vp1, vp2 = A[V_P, i, 0], A[V_P, i, 1], A[V_P, i, 2]
        vt0, vt1, vt2 = A[V_T, i, 0], A[V_T, i, 1], A[V_T, i, 2]
        # b_g acts on v through theta at mid-interval
        vg0, vg1, vg2 = -h * vt0, -h * vt1, -h * vt2
        va0, va1, va2 = -dt * C[i, 0], -dt * C[i, 1], -dt * C[i, 2]
        tt0, tt1, tt2 = A[T_T, i, 0], A[T_T, i, 1], A[T_T, i, 2]
        tg0, tg1, tg2 = A[T_G, i, 0], A[T_G, i, 1], A[T_G, i, 2]
        # one output row a loop: only then does the compiler work on several columns at once
        for c in range(n_v):
            out[3 + i, c] = (
                (vv0 * M[3, c] + vv1 * M[4, c] + vv2 * M[5, c])
                + (vp0 * M[0, c] + vp1 * M[1, c] + vp2 * M[2, c])
                + (vt0 * M[6, c] + vt1 * M[7, c] + vt2 * M[8, c])
                + (vg0 * M[9, c] + vg1 * M[10, c] + vg2 * M[11, c])
                + (va0 * M[12, c] + va1 * M[13, c] + va2 * M[14, c])
            )
        for c in range(n_p):
            out[i, c] = M[i, c] + h * (M[3 + i, c] + out[3 + i, c])
        for c in range(n_t):
            out[6 + i, c] = (tt0 * M[6, c] + tt1 * M[7, c] + tt2 * M[8, c]) + (
                tg0 * M[9, c] + tg1 * M[10, c] + tg2 * M[11, c]
            )


LANES = 4
"""Loops over columns go on to a multiple of this, where scratch has room: they have no rest then."""
TURNED = 12
"""MOVING, so rounded up."""


@kernel
def propagate_covariance(
    P: FloatArray, A: FloatArray, C: FloatArray, dt: float, work: Workspace
) -> None:
    """P <- Phi P Phi^T, in place and exactly symmetric.

    Phi is the identity outside the moving rows, so the columns of the biases are done after one product, and
    the second one is needed for the lower triangle of the moving block only.
    """
    n = P.shape[0]
    _, _, half, turned, block, _ = work
    apply_transition(P, A, C, dt, half, n, n, n)
    for c in range(CORE_SIZE):
        for r in range(MOVING):
            turned[c, r] = half[r, c]
    for r in range(MOVING):
        for c in range(MOVING, n):
            P[r, c] = half[r, c]
    for c in range(MOVING, n):
        for r in range(MOVING):
            P[c, r] = half[r, c]
    # widths from an array, not constants: those would be unrolled into scalar code
    third = turned.shape[1] // 3
    apply_transition(turned, A, C, dt, block, third, 2 * third, 3 * third)
    for r in range(MOVING):
        for c in range(r + 1):
            P[r, c] = block[r, c]
            P[c, r] = block[r, c]


@kernel
def write_gravity_transition(K: FloatArray, x: FloatArray, g: Vector, dt: float) -> None:
    """K (6, 2) <- what an error of gravity's direction adds to those of p_n and v_n in dt: dg dt^2/2 and dg dt."""
    write_gravity_jacobian(K, (x[24], x[25]), g)
    for i in range(3):
        for j in range(2):
            K[3 + i, j] = dt * K[i, j]
            K[i, j] = 0.5 * dt * K[3 + i, j]


@kernel
def add_gravity_transition(M: FloatArray, K: FloatArray) -> None:
    """M <- (I + K) M for M (n, k) over errors of which the last two are gravity's.

    Those stay as they are, so that with the other columns' transition Phi before it this is all of the transition.
    """
    n = M.shape[0]
    for i in range(K.shape[0]):
        for c in range(M.shape[1]):
            M[i, c] += K[i, 0] * M[n - 2, c] + K[i, 1] * M[n - 1, c]


@kernel
def feel_gravity(P: FloatArray, K: FloatArray) -> None:
    """P <- (I + K) P (I + K)^T, in place and exactly symmetric."""
    add_gravity_transition(P, K)
    add_gravity_transition(P.T, K)
    for i in range(K.shape[0]):
        for j in range(i + 1, P.shape[0]):
            P[j, i] = P[i, j]


@kernel
def workspace(n: int, has_gravity: bool) -> Workspace:
    """The scratch arrays that `predict` needs for a covariance of n states, the last two of gravity where it has it."""
    return (
        np.empty((3, 3)),
        np.empty((BLOCKS, 3, 3)),
        np.empty((MOVING, n)),
        np.zeros((CORE_SIZE, TURNED)),
        np.empty((MOVING, TURNED)),
        np.empty((6, 2 if has_gravity else 0)),
    )


@kernel
def add_walks(P: FloatArray, noise: FloatArray, dt: float) -> None:
    """P <- P + the random walks of the states after the core, whose root PSDs follow the four of the IMU in `noise`."""
    for k in range(4, len(noise)):
        i = CORE_SIZE - 4 + k
        P[i, i] += noise[k] * noise[k] * dt


@kernel
def predict(
    x: FloatArray,
    P: FloatArray,
    phi: Vector,
    dv: Vector,
    dt: float,
    noise: FloatArray,
    scale: float,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
    work: Workspace,
) -> None:
    """One interval, in place: x by `mechanize`, P <- Phi P Phi^T + Q, exactly symmetric.

    `noise` (4 + k,) holds the root PSDs of gyro (rad/s/sqrt(Hz)), accelerometer (m/s^2/sqrt(Hz)), gyro bias walk
    (rad/s^2/sqrt(Hz)) and accelerometer bias walk (m/s^3/sqrt(Hz)), then those of the walks of the first k states after
    the core; the first two are taken `scale` times. Q holds the velocity noise with its integral into the position;
    further cross terms are of a higher order in dt.
    """
    C, A, K = work[0], work[1], work[5]
    g = mechanize(x, phi, dv, dt, r0_e, C_ne, w_ie_n, C)
    transition(A, C, g, phi, dv, dt, w_ie_n)
    propagate_covariance(P, A, C, dt, work)
    if K.shape[1]:
        write_gravity_transition(K, x, g, dt)
        feel_gravity(P, K)
    qg = scale * scale * noise[0] * noise[0] * dt
    qa = scale * scale * noise[1] * noise[1] * dt
    qbg = noise[2] * noise[2] * dt
    qba = noise[3] * noise[3] * dt
    for i in range(3):
        P[i, i] += qa * dt * dt / 3.0
        P[i, 3 + i] += 0.5 * qa * dt
        P[3 + i, i] += 0.5 * qa * dt
        P[3 + i, 3 + i] += qa
        P[6 + i, 6 + i] += qg
        P[9 + i, 9 + i] += qbg
        P[12 + i, 12 + i] += qba
    add_walks(P, noise, dt)
