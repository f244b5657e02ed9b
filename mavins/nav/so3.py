"""Rotations: unit quaternions, rotation vectors, direction cosine matrices and Euler angles.

Quaternions are scalar first and Hamilton; `q_nb` and `C_nb` take b to n. Rotation vectors are in rad,
shape (3,). Euler angles are Z-Y-X (yaw, pitch, roll). The attitude error is local: q (x) Exp(theta_b).
Source: Sola, "Quaternion kinematics for the error-state Kalman filter" (2017), sections 1, 2 and 4.
Theory: docs/theory/attitude.md.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray

Quaternion: TypeAlias = tuple[float, float, float, float]

SMALL: Final = 1e-3
"""Below this squared angle (1.8 deg) series are taken: they are exact to rounding there, and quicker."""


@kernel
def skew(v: FloatArray) -> FloatArray:
    """[v]x, the (3, 3) matrix with [v]x w = v x w."""
    S = np.zeros((3, 3))
    S[0, 1] = -v[2]
    S[0, 2] = v[1]
    S[1, 0] = v[2]
    S[1, 2] = -v[0]
    S[2, 0] = -v[1]
    S[2, 1] = v[0]
    return S


@kernel
def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """A x b for (3,) vectors."""
    c = np.empty(3)
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]
    return c


@kernel
def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """`quat_mul` on tuples: the hot kernels use it because a tuple needs no memory of its own."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@kernel
def quat_mul(p: FloatArray, q: FloatArray) -> FloatArray:
    """The Hamilton product p (x) q (Sola eq. 12)."""
    return np.array(product((p[0], p[1], p[2], p[3]), (q[0], q[1], q[2], q[3])))


@kernel
def quat_conj(q: FloatArray) -> FloatArray:
    """The conjugate, which is the inverse of a unit quaternion."""
    r = -q
    r[0] = q[0]
    return r


@kernel
def quat_normalize(q: FloatArray) -> FloatArray:
    """Q scaled to unit length, with a scalar part that is not negative."""
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        n = -n
    return q / n


@kernel
def exponential(x: float, y: float, z: float) -> Quaternion:
    """`quat_exp` on a tuple's worth of floats."""
    a2 = x * x + y * y + z * z
    if a2 < SMALL:
        s = 0.5 - a2 * (1.0 / 48.0 - a2 * (1.0 / 3840.0 - a2 * (1.0 / 645120.0)))
        w = 1.0 - a2 * (1.0 / 8.0 - a2 * (1.0 / 384.0 - a2 * (1.0 / 46080.0)))
    else:
        a = math.sqrt(a2)
        s = math.sin(0.5 * a) / a
        w = math.cos(0.5 * a)
    return (w, s * x, s * y, s * z)


@kernel
def quat_exp(phi: FloatArray) -> FloatArray:
    """Exp(phi): the unit quaternion of a rotation vector (Sola eq. 101)."""
    return np.array(exponential(phi[0], phi[1], phi[2]))


@kernel
def logarithm(q: Quaternion) -> tuple[float, float, float]:
    """`quat_log` on tuples."""
    n2 = q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if 4.0 * n2 < SMALL:
        # 2 asin(n) / n
        s = 2.0 + n2 * (1.0 / 3.0 + n2 * (3.0 / 20.0 + n2 * (5.0 / 56.0 + n2 * (35.0 / 576.0))))
    else:
        n = math.sqrt(n2)
        s = 2.0 * math.atan2(n, abs(q[0])) / n
    if q[0] < 0.0:
        s = -s
    return (s * q[1], s * q[2], s * q[3])


@kernel
def quat_log(q: FloatArray) -> FloatArray:
    """Log(q): the rotation vector, |phi| <= pi, of a unit quaternion (Sola eq. 105)."""
    return np.array(logarithm((q[0], q[1], q[2], q[3])))


@kernel
def write_dcm(C: FloatArray, q: Quaternion) -> None:
    """C <- C(q), in place, for a unit quaternion (Sola eq. 115)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    C[0, 0] = w * w + x * x - y * y - z * z
    C[0, 1] = 2.0 * (x * y - w * z)
    C[0, 2] = 2.0 * (x * z + w * y)
    C[1, 0] = 2.0 * (x * y + w * z)
    C[1, 1] = w * w - x * x + y * y - z * z
    C[1, 2] = 2.0 * (y * z - w * x)
    C[2, 0] = 2.0 * (x * z - w * y)
    C[2, 1] = 2.0 * (y * z + w * x)
    C[2, 2] = w * w - x * x - y * y + z * z


@kernel
def quat_to_dcm(q: FloatArray) -> FloatArray:
    """C(q), the (3, 3) direction cosine matrix of a unit quaternion."""
    C = np.empty((3, 3))
    write_dcm(C, (q[0], q[1], q[2], q[3]))
    return C


@kernel
def dcm_to_quat(C: FloatArray) -> FloatArray:
    """The unit quaternion of a direction cosine matrix, by the largest component (Shepperd 1978)."""
    t = C[0, 0] + C[1, 1] + C[2, 2]
    q = np.empty(4)
    if t >= C[0, 0] and t >= C[1, 1] and t >= C[2, 2]:
        q[0] = 1.0 + t
        q[1] = C[2, 1] - C[1, 2]
        q[2] = C[0, 2] - C[2, 0]
        q[3] = C[1, 0] - C[0, 1]
    elif C[0, 0] >= C[1, 1] and C[0, 0] >= C[2, 2]:
        q[0] = C[2, 1] - C[1, 2]
        q[1] = 1.0 + C[0, 0] - C[1, 1] - C[2, 2]
        q[2] = C[1, 0] + C[0, 1]
        q[3] = C[2, 0] + C[0, 2]
    elif C[1, 1] >= C[2, 2]:
        q[0] = C[0, 2] - C[2, 0]
        q[1] = C[1, 0] + C[0, 1]
        q[2] = 1.0 - C[0, 0] + C[1, 1] - C[2, 2]
        q[3] = C[2, 1] + C[1, 2]
    else:
        q[0] = C[1, 0] - C[0, 1]
        q[1] = C[2, 0] + C[0, 2]
        q[2] = C[2, 1] + C[1, 2]
        q[3] = 1.0 - C[0, 0] - C[1, 1] + C[2, 2]
    return quat_normalize(q)


@kernel
def euler_to_quat(roll: float, pitch: float, yaw: float) -> FloatArray:
    """The quaternion q_nb of Z-Y-X Euler angles in radians."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    q = np.empty(4)
    q[0] = cr * cp * cy + sr * sp * sy
    q[1] = sr * cp * cy - cr * sp * sy
    q[2] = cr * sp * cy + sr * cp * sy
    q[3] = cr * cp * sy - sr * sp * cy
    return q


@kernel
def quat_to_euler(q: FloatArray) -> FloatArray:
    """[roll, pitch, yaw] in radians of q_nb; pitch in [-pi/2, pi/2], roll and yaw in (-pi, pi].

    Straight up or down, where only yaw -+ roll is defined, roll is zero.
    """
    w, x, y, z = q[0], q[1], q[2], q[3]
    euler = np.empty(3)
    north, east = w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)
    level = math.sqrt(north * north + east * east)
    euler[1] = math.atan2(2.0 * (w * y - x * z), level)
    if level < 1e-12:
        euler[0] = 0.0
        euler[2] = math.atan2(2.0 * (w * z - x * y), w * w - x * x + y * y - z * z)
    else:
        euler[0] = math.atan2(2.0 * (y * z + w * x), w * w - x * x - y * y + z * z)
        euler[2] = math.atan2(east, north)
    return euler


@kernel
def euler_jacobian(roll: float, pitch: float) -> FloatArray:
    """d(roll, pitch, yaw) / d theta_b, (3, 3): the kinematic matrix of Z-Y-X angles.

    cos(pitch) is held away from zero (1e-6), so the result stays finite at the singularity.
    """
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    if abs(cp) < 1e-6:
        cp = 1e-6 if cp >= 0.0 else -1e-6
    E = np.zeros((3, 3))
    E[0, 0] = 1.0
    E[0, 1] = sr * sp / cp
    E[0, 2] = cr * sp / cp
    E[1, 1] = cr
    E[1, 2] = -sr
    E[2, 1] = sr / cp
    E[2, 2] = cr / cp
    return E


@kernel
def write_right_jacobian(J: FloatArray, x: float, y: float, z: float) -> None:
    """J <- Jr(phi), in place, for phi = (x, y, z): I - c1 [phi]x + c2 [phi]x^2 (Sola eq. 183)."""
    a2 = x * x + y * y + z * z
    if a2 < SMALL:
        c1 = 0.5 - a2 * (1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 * (1.0 / 40320.0)))
        c2 = 1.0 / 6.0 - a2 * (1.0 / 120.0 - a2 * (1.0 / 5040.0 - a2 * (1.0 / 362880.0)))
    else:
        a = math.sqrt(a2)
        c1 = (1.0 - math.cos(a)) / a2
        c2 = (a - math.sin(a)) / (a2 * a)
    J[0, 0] = 1.0 - c2 * (y * y + z * z)
    J[0, 1] = c1 * z + c2 * x * y
    J[0, 2] = -c1 * y + c2 * x * z
    J[1, 0] = -c1 * z + c2 * x * y
    J[1, 1] = 1.0 - c2 * (x * x + z * z)
    J[1, 2] = c1 * x + c2 * y * z
    J[2, 0] = c1 * y + c2 * x * z
    J[2, 1] = -c1 * x + c2 * y * z
    J[2, 2] = 1.0 - c2 * (x * x + y * y)


@kernel
def right_jacobian(phi: FloatArray) -> FloatArray:
    """Jr(phi) (3, 3) with Exp(phi + d) ~ Exp(phi) Exp(Jr d)."""
    J = np.empty((3, 3))
    write_right_jacobian(J, phi[0], phi[1], phi[2])
    return J


@kernel
def right_jacobian_inv(phi: FloatArray) -> FloatArray:
    """Jr^-1(phi) with Log(Exp(phi) Exp(d)) ~ phi + Jr^-1 d (Sola eq. 184)."""
    a2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    S = skew(phi)
    if a2 < 1e-6:
        c = 1.0 / 12.0 + a2 / 720.0
    else:
        a = math.sqrt(a2)
        c = 1.0 / a2 - (1.0 + math.cos(a)) / (2.0 * a * math.sin(a))
    J: FloatArray = np.eye(3) + 0.5 * S + c * (S @ S)
    return J


@kernel
def wrap_pi(angle: float) -> float:
    """The angle in (-pi, pi]."""
    wrapped = angle - 2.0 * math.pi * float(np.floor((angle + math.pi) / (2.0 * math.pi)))
    return math.pi if wrapped <= -math.pi else wrapped
