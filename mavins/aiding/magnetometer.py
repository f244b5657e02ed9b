"""Magnetometer: the Earth's field as a vector, seen in b.

    h = C_nb^T m_n,   H_theta = [h]x

Source: Groves (2013), section 6.1.1, with the local attitude error of Sola (2017). Theory: docs/theory/magnetometer.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.so3 import quat_to_dcm
from mavins.types import FloatArray

NAME = "magnetometer"
RANK = 4


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (3,) in the unit of the field and Jacobian (3, 19); `parameters` is m_n (3)."""
    C = quat_to_dcm(x[6:10])
    r = np.empty(3)
    h = np.empty(3)
    for i in range(3):
        h[i] = C[0, i] * parameters[0] + C[1, i] * parameters[1] + C[2, i] * parameters[2]
        r[i] = z[i] - h[i]
    H = np.zeros((3, CANONICAL_SIZE))
    H[0, 7] = -h[2]
    H[0, 8] = h[1]
    H[1, 6] = h[2]
    H[1, 8] = -h[0]
    H[2, 6] = -h[1]
    H[2, 7] = h[0]
    return r, H


def measure(
    stamp_us: int,
    t_us: int,
    field_b: FloatArray,
    reference_n: FloatArray,
    sigma: float,
    gate: float,
    source: str = NAME,
) -> Measurement:
    """A field (3,) valid at `t_us`; it, the field (3,) in n at that place and the 1-sigma noise are in one unit."""
    return Measurement(
        NAME,
        RANK,
        source,
        stamp_us,
        t_us,
        field_b,
        np.eye(3) * sigma**2,
        reference_n,
        model,
        gate,
    )
