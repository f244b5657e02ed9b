"""Zero velocity: the vehicle is known to stand, so v_n = 0.

    h = v_n,   H_v = I

Source: Skog, Handel, Nilsson and Rantakokko (2010), "Zero-velocity detection". Theory: docs/theory/zero_velocity.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.types import FloatArray

NAME = "zero_velocity"
RANK = 3


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (3,) in m/s in n and Jacobian (3, 25); `parameters` is not used."""
    r = z - x[3:6]
    H = np.zeros((3, CANONICAL_SIZE))
    for i in range(3):
        H[i, 3 + i] = 1.0
    return r, H


def measure(stamp_us: int, t_us: int, sigma: float, gate: float) -> Measurement:
    """Zero velocity at `t_us` with a 1-sigma noise in m/s, found out at `stamp_us`."""
    return Measurement(
        NAME,
        RANK,
        "standing",
        stamp_us,
        t_us,
        np.zeros(3),
        np.eye(3) * sigma**2,
        np.empty(0),
        model,
        gate,
    )
