"""Rotations of many instants at once: quaternions in rows (N, 4), as in mavins.nav.so3.

Theory: docs/theory/attitude.md.
"""

from __future__ import annotations

import numpy as np

from mavins.types import FloatArray


def euler_to_quats(euler: FloatArray) -> FloatArray:
    """q_nb (N, 4) of [roll, pitch, yaw] (N, 3) in rad; continuous where the angles are."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * euler.T), np.sin(0.5 * euler.T)
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def quats_to_dcms(q: FloatArray) -> FloatArray:
    """C_nb (N, 3, 3) of unit quaternions (N, 4)."""
    w, x, y, z = q.T
    rows = [
        [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def quat_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """The Hamilton products p (x) q (N, 4), row by row."""
    pw, px, py, pz = p.T
    qw, qx, qy, qz = q.T
    return np.column_stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )


def rates_of(q: FloatArray, q_dot: FloatArray) -> FloatArray:
    """w_nb_b (N, 3) in rad/s: 2 vec(q* (x) q') / |q|^2, which holds for q of any length."""
    conjugate = q * [1.0, -1.0, -1.0, -1.0]
    twice = 2.0 / np.einsum("ni,ni->n", q, q)
    rates: FloatArray = twice[:, None] * quat_product(conjugate, q_dot)[:, 1:]
    return rates


def yaws_of(q: FloatArray) -> FloatArray:
    """The yaw (N,) in rad, in (-pi, pi], of quaternions (N, 4)."""
    w, x, y, z = q.T
    yaws: FloatArray = np.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)
    return yaws
