"""How far apart two states are after an interval that they began a given error apart: f(x [+] e) [-] f(x), exactly.

The same mechanization as ins.py, of which ins.transition is the derivative. Only what differs is computed, and so at
the precision of the error, not of the state:

    theta after = Log(Exp(-phi) Exp(theta) Exp(phi')),   du = C_nb (Exp(theta) dv' - dv)
    v after = v + d,   p after = p + dt (v + d / 2),   d = du + dg dt - w_ie x (dt/2 du + 2 dt (v + (du + dg dt) / 2))

for errors p, v, theta, of which phi' and dv' are the increments with another rate and specific force, and dg is the
difference of gravity between the two midpoints. Theory: docs/theory/srcdkf.md.
"""

from __future__ import annotations

from typing import NamedTuple

from mavins.nav.ins import Vector
from mavins.nav.kernels import kernel
from mavins.nav.so3 import Quaternion, exponential, logarithm, product
from mavins.types import FloatArray


class Interval(NamedTuple):
    """What the deviations over one interval have in common; W, F, dv and phi as in ins.increments_from_rates.

    `fixed` is (dt^2/12) (w0 x f1 + f0 x w1), `dw` and `df` are (dt^2/12) (w0 - w1) and (dt^2/12) (f0 - f1); `back` is
    Exp(-phi); `middle` the place in n at mid-interval where gravity is `g`, `w_ie` the Earth rate.
    """

    dt: float
    W: Vector
    F: Vector
    fixed: Vector
    dw: Vector
    df: Vector
    phi: Vector
    dv: Vector
    back: Quaternion
    middle: Vector
    g: Vector
    w_ie: Vector


@kernel
def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def interval(
    w0: Vector,
    f0: Vector,
    w1: Vector,
    f1: Vector,
    phi: Vector,
    dv: Vector,
    dt: float,
    middle: Vector,
    g: Vector,
    w_ie_n: FloatArray,
) -> Interval:
    """The interval with these readings at its ends, which gave the increments (phi, dv)."""
    h = 0.5 * dt
    k = dt * dt / 12.0
    s1, s2 = _cross(w0, f1), _cross(f0, w1)
    return Interval(
        dt,
        ((w0[0] + w1[0]) * h, (w0[1] + w1[1]) * h, (w0[2] + w1[2]) * h),
        ((f0[0] + f1[0]) * h, (f0[1] + f1[1]) * h, (f0[2] + f1[2]) * h),
        (k * (s1[0] + s2[0]), k * (s1[1] + s2[1]), k * (s1[2] + s2[2])),
        (k * (w0[0] - w1[0]), k * (w0[1] - w1[1]), k * (w0[2] - w1[2])),
        (k * (f0[0] - f1[0]), k * (f0[1] - f1[1]), k * (f0[2] - f1[2])),
        phi,
        dv,
        exponential(-phi[0], -phi[1], -phi[2]),
        middle,
        g,
        (w_ie_n[0], w_ie_n[1], w_ie_n[2]),
    )


@kernel
def turned(
    i: Interval, C: FloatArray, theta: Vector, w: Vector, f: Vector
) -> tuple[Vector, Vector]:
    """(theta after, du): an attitude error, and errors `w`, `f` of rate and specific force over the whole interval."""
    dt = i.dt
    coning = _cross(i.dw, w)
    e = exponential(theta[0], theta[1], theta[2])
    q = product(
        product(i.back, e),
        exponential(
            i.phi[0] + dt * w[0] + coning[0],
            i.phi[1] + dt * w[1] + coning[1],
            i.phi[2] + dt * w[2] + coning[2],
        ),
    )
    W = (i.W[0] + dt * w[0], i.W[1] + dt * w[1], i.W[2] + dt * w[2])
    F = (i.F[0] + dt * f[0], i.F[1] + dt * f[1], i.F[2] + dt * f[2])
    rotation = _cross(W, F)
    twice = _cross(W, rotation)
    s1, s2 = _cross(i.dw, f), _cross(i.df, w)
    b0 = F[0] + 0.5 * rotation[0] + twice[0] / 6.0 + i.fixed[0] + s1[0] + s2[0]
    b1 = F[1] + 0.5 * rotation[1] + twice[1] / 6.0 + i.fixed[1] + s1[1] + s2[1]
    b2 = F[2] + 0.5 * rotation[2] + twice[2] / 6.0 + i.fixed[2] + s1[2] + s2[2]
    axis = (e[1], e[2], e[3])
    once = _cross(axis, (b0, b1, b2))
    again = _cross(axis, once)
    # the difference of the increments, and what the rotation adds: small terms only
    b0 = (b0 - i.dv[0]) + 2.0 * (e[0] * once[0] + again[0])
    b1 = (b1 - i.dv[1]) + 2.0 * (e[0] * once[1] + again[1])
    b2 = (b2 - i.dv[2]) + 2.0 * (e[0] * once[2] + again[2])
    return logarithm(q), (
        C[0, 0] * b0 + C[0, 1] * b1 + C[0, 2] * b2,
        C[1, 0] * b0 + C[1, 1] * b1 + C[1, 2] * b2,
        C[2, 0] * b0 + C[2, 1] * b1 + C[2, 2] * b2,
    )


@kernel
def moved(i: Interval, p: Vector, v: Vector, du: Vector, dg: Vector) -> tuple[Vector, Vector]:
    """(p after, v after) of errors of position and velocity, with du and dg."""
    dt = i.dt
    h = 0.5 * dt
    a0, a1, a2 = du[0] + dg[0] * dt, du[1] + dg[1] * dt, du[2] + dg[2] * dt
    swept = _cross(
        i.w_ie,
        (
            h * du[0] + 2.0 * dt * (v[0] + 0.5 * a0),
            h * du[1] + 2.0 * dt * (v[1] + 0.5 * a1),
            h * du[2] + 2.0 * dt * (v[2] + 0.5 * a2),
        ),
    )
    d0, d1, d2 = a0 - swept[0], a1 - swept[1], a2 - swept[2]
    return (
        (p[0] + dt * (v[0] + 0.5 * d0), p[1] + dt * (v[1] + 0.5 * d1), p[2] + dt * (v[2] + 0.5 * d2)),
        (v[0] + d0, v[1] + d1, v[2] + d2),
    )
