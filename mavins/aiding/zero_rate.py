"""Zero rate: the vehicle is known to stand, so that its gyros read their bias and the Earth's rotation.

    h = b_g + C_bn w_ie_n,   H_bg = I,   H_theta = [C_bn w_ie_n]x

with the mean of the gyro readings over a while as the measurement: one reading has more noise. Source: Groves (2013),
section 15.2. Theory: docs/theory/zero_rate.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.earth import TangentFrame
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.so3 import quat_to_dcm, skew
from mavins.types import FloatArray

NAME = "zero_rate"
RANK = 5


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (3,) in rad/s in b and Jacobian (3, 25); `parameters` is w_ie_n (3,)."""
    C = quat_to_dcm(x[6:10])
    w_ie_b = np.empty(3)
    for i in range(3):
        w_ie_b[i] = C[0, i] * parameters[0] + C[1, i] * parameters[1] + C[2, i] * parameters[2]
    r = np.empty(3)
    H = np.zeros((3, CANONICAL_SIZE))
    cross = skew(w_ie_b)
    for i in range(3):
        r[i] = z[i] - x[10 + i] - w_ie_b[i]
        H[i, 9 + i] = 1.0
        for j in range(3):
            H[i, 6 + j] = cross[i, j]
    return r, H


def measure(
    stamp_us: int, t_us: int, gyro_b: FloatArray, frame: TangentFrame, sigma: float, gate: float
) -> Measurement:
    """Zero rate at `t_us` from a mean reading `gyro_b` (3,) with a 1-sigma noise in rad/s, found at `stamp_us`."""
    return Measurement(
        NAME,
        RANK,
        "standing",
        stamp_us,
        t_us,
        gyro_b,
        np.eye(3) * sigma**2,
        frame.w_ie_n,
        model,
        gate,
    )
