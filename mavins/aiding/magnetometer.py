"""Magnetometer: the Earth's field along the body's axes, and the vehicle's own.

    h = C_nb^T m_n + b_m,   H_theta = [C_nb^T m_n]x,   H_b = I

Of a direction z, whose strength is not known:

    r = z - h/|h|,   H_theta and H_b as above times (I - h h^T/|h|^2)/|h|

Source: Sola (2017), section 4 (the right Jacobian of a rotated vector). Theory: docs/theory/magnetometer.md.
"""

from __future__ import annotations

import math

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.so3 import quat_to_dcm, skew
from mavins.types import FloatArray

NAME = "magnetometer"
RANK = 4


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (3,) in b and Jacobian (3, 25); `parameters` is the field m_n (3), in the unit of z.

    Where z is a direction, m_n is a unit vector, and a 1 follows it.
    """
    C = quat_to_dcm(x[6:10])
    m_b = np.empty(3)
    for i in range(3):
        m_b[i] = C[0, i] * parameters[0] + C[1, i] * parameters[1] + C[2, i] * parameters[2]
    S = skew(m_b)
    H = np.zeros((3, CANONICAL_SIZE))
    for i in range(3):
        H[i, 20 + i] = 1.0
        for j in range(3):
            H[i, 6 + j] = S[i, j]
    h = m_b + x[21:24]
    if len(parameters) == 3:
        return z - h, H
    strength = math.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
    # nothing of z is in H: its noise would meet itself in the residual, and push the field's strength one way
    d = h / strength
    for j in range(6, 23):
        along = d[0] * H[0, j] + d[1] * H[1, j] + d[2] * H[2, j]
        for i in range(3):
            H[i, j] = (H[i, j] - along * d[i]) / strength
    return z - d, H


def measure(
    source: str,
    stamp_us: int,
    t_us: int,
    field_b: FloatArray,
    field_n: FloatArray,
    sigma: float,
    gate: float,
    directions: bool = False,
) -> Measurement:
    """A field (3,) along the body's axes, valid at `t_us`, where the reference is `field_n` (3,).

    The 1-sigma noise of each axis is in the unit of the field, which may be any. With `directions` both are unit
    vectors, and how strong the field was is not known: it need not be the reference's where the vehicle adds to it.
    """
    return Measurement(
        NAME,
        RANK,
        source,
        stamp_us,
        t_us,
        np.array(field_b, dtype=np.float64),
        np.eye(3) * sigma**2,
        np.append(field_n, 1.0) if directions else np.array(field_n, dtype=np.float64),
        model,
        gate,
    )
