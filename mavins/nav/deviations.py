"""How far apart two states are after an interval that they began a given error apart: f(x [+] e) [-] f(x), exactly.

The same mechanization as ins.py, of which ins.transition is the derivative. Only what differs is computed, and so at
the precision of the error, not of the state:

    theta after = Log(Exp(-phi) Exp(theta) Exp(phi')),   du = C_nb (Exp(theta) dv' - dv)
    v after = v + d,   p after = p + dt (v + d / 2),   d = du + dg dt - w_ie x (dt/2 du + 2 dt (v + (du + dg dt) / 2))

for errors p, v, theta, of which phi' and dv' are the increments with another rate and specific force, and dg is the
difference of gravity between the two midpoints. An error and its opposite are taken at once, by the odd part
(d+ - d-) / 2 and the even part (d+ + d-) / 2, which share most of the work. Theory: docs/theory/srcdkf.md.
"""

from __future__ import annotations

from mavins.nav.ins import Vector
from mavins.nav.kernels import kernel
from mavins.nav.so3 import exponential, logarithm, product
from mavins.types import FloatArray

INTERVAL = 41
"""What the deviations over one interval have in common is an array of this length: a long tuple is slow to hand on."""
DT = 0
W, F, DW, DF, PHI, DV = range(1, 19, 3)
"""W, F, phi and dv as in ins.increments_from_rates, and (dt^2/12) (w0 - w1), (dt^2/12) (f0 - f1)."""
BACK = 19
"""Exp(-phi)."""
MIDDLE, GRAVITY, EARTH, TO_N = 23, 26, 29, 32
"""The place in n at mid-interval, gravity there, the Earth rate, and C_nb at the start by rows."""


@kernel
def _vector(c: FloatArray, k: int) -> Vector:
    return (c[k], c[k + 1], c[k + 2])


@kernel
def _put(c: FloatArray, k: int, v: Vector) -> None:
    c[k], c[k + 1], c[k + 2] = v[0], v[1], v[2]


@kernel
def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def write_interval(
    c: FloatArray,
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
    C: FloatArray,
) -> None:
    """C (INTERVAL,) <- the interval with these readings at its ends, which gave the increments (phi, dv)."""
    h = 0.5 * dt
    k = dt * dt / 12.0
    c[DT] = dt
    _put(c, W, ((w0[0] + w1[0]) * h, (w0[1] + w1[1]) * h, (w0[2] + w1[2]) * h))
    _put(c, F, ((f0[0] + f1[0]) * h, (f0[1] + f1[1]) * h, (f0[2] + f1[2]) * h))
    _put(c, DW, (k * (w0[0] - w1[0]), k * (w0[1] - w1[1]), k * (w0[2] - w1[2])))
    _put(c, DF, (k * (f0[0] - f1[0]), k * (f0[1] - f1[1]), k * (f0[2] - f1[2])))
    _put(c, PHI, phi)
    _put(c, DV, dv)
    c[BACK], c[BACK + 1], c[BACK + 2], c[BACK + 3] = exponential(-phi[0], -phi[1], -phi[2])
    _put(c, MIDDLE, middle)
    _put(c, GRAVITY, g)
    _put(c, EARTH, (w_ie_n[0], w_ie_n[1], w_ie_n[2]))
    for j in range(9):
        c[TO_N + j] = C[j // 3, j % 3]


@kernel
def _sum(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel
def _scaled(s: float, a: Vector) -> Vector:
    return (s * a[0], s * a[1], s * a[2])


@kernel
def _to_n(c: FloatArray, a: Vector) -> Vector:
    return (
        c[TO_N] * a[0] + c[TO_N + 1] * a[1] + c[TO_N + 2] * a[2],
        c[TO_N + 3] * a[0] + c[TO_N + 4] * a[1] + c[TO_N + 5] * a[2],
        c[TO_N + 6] * a[0] + c[TO_N + 7] * a[1] + c[TO_N + 8] * a[2],
    )


@kernel
def turned(c: FloatArray, theta: Vector, w: Vector) -> tuple[Vector, Vector]:
    """The odd and the even part of the attitude error after the interval; `w` is an error of the rate all along."""
    dt = c[DT]
    back = (c[BACK], c[BACK + 1], c[BACK + 2], c[BACK + 3])
    if w[0] == 0.0 and w[1] == 0.0 and w[2] == 0.0:
        # Exp(-phi) Exp(theta) Exp(phi) is theta seen from the turned body
        axis = (back[1], back[2], back[3])
        once = _cross(axis, theta)
        twice = _cross(axis, once)
        add = _scaled(2.0, _sum(_scaled(back[0], once), twice))
        return _sum(theta, add), (0.0, 0.0, 0.0)
    e = exponential(theta[0], theta[1], theta[2])
    coning = _cross(_vector(c, DW), w)
    a0, a1, a2 = dt * w[0] + coning[0], dt * w[1] + coning[1], dt * w[2] + coning[2]
    p0, p1, p2 = c[PHI], c[PHI + 1], c[PHI + 2]
    plus = logarithm(product(product(back, e), exponential(p0 + a0, p1 + a1, p2 + a2)))
    e = (e[0], -e[1], -e[2], -e[3])
    minus = logarithm(product(product(back, e), exponential(p0 - a0, p1 - a1, p2 - a2)))
    return (
        (0.5 * (plus[0] - minus[0]), 0.5 * (plus[1] - minus[1]), 0.5 * (plus[2] - minus[2])),
        (0.5 * (plus[0] + minus[0]), 0.5 * (plus[1] + minus[1]), 0.5 * (plus[2] + minus[2])),
    )


@kernel
def pushed(c: FloatArray, theta: Vector, w: Vector, f: Vector) -> tuple[Vector, Vector]:
    """The odd and the even part of du; `w` and `f` are errors of rate and specific force all along.

    With a = w dt and b = f dt, W' x F' = W x F +- r1 + r2 where r1 = W x b + a x F and r2 = a x b, and so on.
    """
    W0, F0, dw, df = _vector(c, W), _vector(c, F), _vector(c, DW), _vector(c, DF)
    a, b = _scaled(c[DT], w), _scaled(c[DT], f)
    r1 = _sum(_cross(W0, b), _cross(a, F0))
    r2 = _cross(a, b)
    t1 = _sum(_cross(W0, r1), _cross(a, _sum(_cross(W0, F0), r2)))
    t2 = _sum(_cross(W0, r2), _cross(a, r1))
    sculling = _sum(_cross(dw, f), _cross(df, w))
    odd = _sum(_sum(b, sculling), _sum(_scaled(0.5, r1), _scaled(1.0 / 6.0, t1)))
    even = _sum(_scaled(0.5, r2), _scaled(1.0 / 6.0, t2))
    # Exp(+- theta) y = y +- 2 e0 (e x y) + 2 e x (e x y) of an odd and an even y
    e = exponential(theta[0], theta[1], theta[2])
    axis = (e[1], e[2], e[3])
    whole = _sum(_vector(c, DV), even)
    odd_once, even_once = _cross(axis, odd), _cross(axis, whole)
    odd_add = _sum(_scaled(e[0], even_once), _cross(axis, odd_once))
    even_add = _sum(_scaled(e[0], odd_once), _cross(axis, even_once))
    return (
        _to_n(c, _sum(odd, _scaled(2.0, odd_add))),
        _to_n(c, _sum(even, _scaled(2.0, even_add))),
    )


@kernel
def moved(c: FloatArray, p: Vector, v: Vector, du: Vector, dg: Vector) -> tuple[Vector, Vector]:
    """(p after, v after) of errors of position and velocity, with du and dg; linear: for odd and even parts alike."""
    dt = c[DT]
    h = 0.5 * dt
    a0, a1, a2 = du[0] + dg[0] * dt, du[1] + dg[1] * dt, du[2] + dg[2] * dt
    swept = _cross(
        _vector(c, EARTH),
        (
            h * du[0] + 2.0 * dt * (v[0] + 0.5 * a0),
            h * du[1] + 2.0 * dt * (v[1] + 0.5 * a1),
            h * du[2] + 2.0 * dt * (v[2] + 0.5 * a2),
        ),
    )
    d0, d1, d2 = a0 - swept[0], a1 - swept[1], a2 - swept[2]
    return (
        (
            p[0] + dt * (v[0] + 0.5 * d0),
            p[1] + dt * (v[1] + 0.5 * d1),
            p[2] + dt * (v[2] + 0.5 * d2),
        ),
        (v[0] + d0, v[1] + d1, v[2] + d2),
    )
