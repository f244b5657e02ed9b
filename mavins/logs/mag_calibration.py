"""How a magnetometer is mounted and what the vehicle adds to its field, found in a whole recorded flight.

The Earth's field stands still while the vehicle turns. With the turn C from one instant to another from the gyros,
R the sensor's mounting and b its hard iron, along the sensor's axes,

    m_2 - b = R^T C^T R (m_1 - b),

which is linear in b: no model of the field, no attitude, no full sphere is needed. The mounting is the one of the 24
at right angles that leaves the smallest residual. Theory: docs/theory/compass.md.
"""

from __future__ import annotations

from itertools import pairwise, permutations, product
from typing import Final, NamedTuple

import numpy as np

from mavins.nav.kernels import kernel
from mavins.nav.so3 import (
    dcm_to_quat,
    euler_to_quat,
    quat_exp,
    quat_mul,
    quat_normalize,
    quat_to_dcm,
    quat_to_euler,
)
from mavins.types import FloatArray, IntArray

_PERIOD_US: Final = 200_000
_APART_US: Final = 2_000_000
"""Readings are thinned to the first, and compared with the one that comes so much later: over 2 s gyros are good."""
_NOISE: Final = 0.02
"""Turns below so many rad say nothing about the hard iron, which is then taken for none."""
_CLEARLY: Final = 0.5
"""The squared residuals of another mounting than along the body's axes must be below this share of theirs."""

_PIECE: Final = 100_000
"""IMU samples that are turned at once."""
_ALONG: Final[FloatArray] = np.eye(3)


class MagCalibration(NamedTuple):
    """Roll, pitch, yaw in rad that turn the sensor's axes into the body's, and the hard iron along the sensor's."""

    rotation: tuple[float, float, float]
    hard_iron: tuple[float, float, float]


@kernel
def turns(t_us: IntArray, gyro_b: FloatArray, at_us: IntArray, q: FloatArray) -> FloatArray:
    """Attitudes (M, 4) at instants, from q (4,) at the first sample, from rates (N, 3) on lines between samples."""
    out = np.empty((len(at_us), 4))
    k = 0
    for i in range(len(at_us)):
        while k + 1 < len(t_us) and t_us[k + 1] <= at_us[i]:
            dt = (t_us[k + 1] - t_us[k]) * 1e-6
            q = quat_normalize(quat_mul(q, quat_exp((gyro_b[k] + gyro_b[k + 1]) * (0.5 * dt))))
            k += 1
        out[i] = quat_mul(q, quat_exp(gyro_b[k] * ((at_us[i] - t_us[k]) * 1e-6)))
    return out


def _attitudes(t_us: IntArray, gyro: FloatArray, C: FloatArray, at_us: IntArray) -> FloatArray:
    """`turns` of rates C gyro (N, 3), in pieces, for they are the largest table of a log."""
    q = np.array([1.0, 0.0, 0.0, 0.0])
    out = np.tile(q, (len(at_us), 1))
    edges = [*range(0, len(t_us) - 1, _PIECE), len(t_us) - 1]
    for first, last in pairwise(edges):
        rows = slice(first, last + 1)
        within = slice(
            *np.searchsorted(at_us, (t_us[first], t_us[last] + (rows.stop == len(t_us))))
        )
        q_at = turns(t_us[rows], gyro[rows] @ C.T, np.append(at_us[within], t_us[last]), q)
        out[within], q = q_at[:-1], q_at[-1]
    return out


def calibrate(
    t_us: IntArray,
    gyro: FloatArray,
    mag_us: IntArray,
    field: FloatArray,
    rotation: tuple[float, float, float] | None = None,
    C_bs: FloatArray = _ALONG,
) -> MagCalibration:
    """The mounting, if it is not given as a `rotation`, and the hard iron.

    Rates `gyro` (N, 3) rad/s at `t_us` (N,), along the IMU's axes, which C_bs (3, 3) turns into the body's; readings
    `field` (M, 3) in any unit at `mag_us` (M,).
    """
    inside = (mag_us >= t_us[0]) & (mag_us <= t_us[-1])
    mag_us, field = mag_us[inside], field[inside]
    chosen = np.unique(mag_us // _PERIOD_US, return_index=True)[1]
    mag_us, field = mag_us[chosen], field[chosen]
    spacing = float(np.median(np.diff(mag_us))) if len(mag_us) > 1 else _PERIOD_US
    apart = max(1, round(_APART_US / spacing))
    near = np.flatnonzero(mag_us[apart:] - mag_us[:-apart] < 2 * _APART_US)
    attitudes = _attitudes(t_us, gyro, C_bs, mag_us)
    C = np.array([quat_to_dcm(q) for q in attitudes]).reshape(-1, 3, 3)
    turn = np.transpose(C[near + apart], (0, 2, 1)) @ C[near]  # C^T of the docstring
    before, after = field[near], field[near + apart]
    mountings = _mountings() if rotation is None else [quat_to_dcm(euler_to_quat(*rotation))]
    fits = [_hard_iron(R.T @ turn @ R, before, after) for R in mountings]
    best = min(range(len(fits)), key=lambda i: fits[i].residual)
    if fits[best].residual > _CLEARLY * fits[0].residual:
        best = 0
    if rotation is None:
        rotation = _vector(quat_to_euler(dcm_to_quat(mountings[best])))
    return MagCalibration(rotation, _vector(fits[best].b))


class _Fit(NamedTuple):
    b: FloatArray
    residual: float


def _hard_iron(turn: FloatArray, before: FloatArray, after: FloatArray) -> _Fit:
    """Least squares of (I - turn) b = after - turn before, drawn to 0 where little shows b."""
    A = np.eye(3) - turn
    y = after - np.einsum("kij,kj->ki", turn, before)
    normal = np.einsum("kji,kjl->il", A, A) + max(len(A), 1) * _NOISE**2 * np.eye(3)
    b = np.linalg.solve(normal, np.einsum("kji,kj->i", A, y))
    return _Fit(b, float(np.sum((y - A @ b) ** 2)))


def _mountings() -> list[FloatArray]:
    """The 24 rotations (3, 3) that take axes to axes, the identity first."""
    signed = [
        np.eye(3)[list(order)] * np.array(signs)
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [R for R in signed if np.linalg.det(R) > 0.0]


def _vector(values: FloatArray) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))
