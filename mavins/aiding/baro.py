"""Barometric altitude, brought to the level of the altitudes in n.

    h = alt(p_n) + b_baro,   H_p = -(the local level frame's down axis in n),   H_b = 1

Source: Groves (2013), section 6.2.1. Theory: docs/theory/baro.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.earth import TangentFrame, dcm_ln, ecef_of, ecef_to_lla
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.types import FloatArray

NAME = "baro"
RANK = 6


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (1,) in m and Jacobian (1, 25); `parameters` is r0_e (3), then C_ne (9, row-major)."""
    C_ne = parameters[3:12].reshape(3, 3)
    lla = ecef_to_lla(ecef_of(x[0:3], parameters[:3], C_ne))
    C_ln = dcm_ln(lla[0], lla[1], C_ne)
    r = np.empty(1)
    r[0] = z[0] - lla[2] - x[20]
    H = np.zeros((1, CANONICAL_SIZE))
    for j in range(3):
        H[0, j] = -C_ln[2, j]
    H[0, 19] = 1.0
    return r, H


def measure(
    stamp_us: int,
    t_us: int,
    alt: float,
    frame: TangentFrame,
    sigma: float,
    gate: float,
    source: str = NAME,
) -> Measurement:
    """An altitude in m above mean sea level, valid at `t_us`, with a 1-sigma noise in m."""
    return Measurement(
        NAME,
        RANK,
        source,
        stamp_us,
        t_us,
        np.array([alt]),
        np.array([[sigma**2]]),
        frame.parameters,
        model,
        gate,
    )
