"""Magnetometer: the Earth's field along the body's axes.

    h = C_nb^T m_n,   H_theta = [h]x

Source: Sola (2017), section 4 (the right Jacobian of a rotated vector). Theory: docs/theory/magnetometer.md.
"""

from __future__ import annotations

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
    """Residual (3,) in b and Jacobian (3, 19); `parameters` is the field m_n (3), in the unit of z."""
    C = quat_to_dcm(x[6:10])
    h = np.empty(3)
    for i in range(3):
        h[i] = C[0, i] * parameters[0] + C[1, i] * parameters[1] + C[2, i] * parameters[2]
    S = skew(h)
    H = np.zeros((3, CANONICAL_SIZE))
    for i in range(3):
        for j in range(3):
            H[i, 6 + j] = S[i, j]
    return z - h, H


def measure(
    source: str,
    stamp_us: int,
    t_us: int,
    field_b: FloatArray,
    field_n: FloatArray,
    sigma: float,
    gate: float,
) -> Measurement:
    """A field (3,) along the body's axes, valid at `t_us`, where the reference is `field_n` (3,).

    The 1-sigma noise of each axis is in the unit of the field, which may be any.
    """
    return Measurement(
        NAME,
        RANK,
        source,
        stamp_us,
        t_us,
        np.array(field_b, dtype=np.float64),
        np.eye(3) * sigma**2,
        np.array(field_n, dtype=np.float64),
        model,
        gate,
    )
