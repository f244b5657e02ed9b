"""Residuals of many states in one call, for filters that probe a measurement instead of differentiating it."""

from __future__ import annotations

import numpy as np

from mavins.aiding import (
    baro,
    gnss_position,
    gnss_velocity,
    gravity_tilt,
    heading,
    magnetometer,
    nonholonomic,
    zero_rate,
    zero_velocity,
)
from mavins.nav.kernels import kernel
from mavins.types import FloatArray


@kernel
def residuals(
    rank: int, X: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> FloatArray:
    """Residuals (k, m) of the aiding with this rank at the nominal states X (k, 26)."""
    out = np.empty((len(X), len(z)))
    for k in range(len(X)):
        if rank == gnss_position.RANK:
            out[k] = gnss_position.model(X[k], u, z, parameters)[0]
        elif rank == gnss_velocity.RANK:
            out[k] = gnss_velocity.model(X[k], u, z, parameters)[0]
        elif rank == heading.RANK:
            out[k] = heading.model(X[k], u, z, parameters)[0]
        elif rank == zero_velocity.RANK:
            out[k] = zero_velocity.model(X[k], u, z, parameters)[0]
        elif rank == magnetometer.RANK:
            out[k] = magnetometer.model(X[k], u, z, parameters)[0]
        elif rank == zero_rate.RANK:
            out[k] = zero_rate.model(X[k], u, z, parameters)[0]
        elif rank == baro.RANK:
            out[k] = baro.model(X[k], u, z, parameters)[0]
        elif rank == gravity_tilt.RANK:
            out[k] = gravity_tilt.model(X[k], u, z, parameters)[0]
        elif rank == nonholonomic.RANK:
            out[k] = nonholonomic.model(X[k], u, z, parameters)[0]
        else:
            out[k] = np.nan
    return out
