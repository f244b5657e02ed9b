"""Every aiding in kernels that are told which: what a measurement says of a state, or of many states in one call."""

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
from mavins.nav.layout import CANONICAL_SIZE
from mavins.types import FloatArray


@kernel
def linearize(
    rank: int, x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (m,) and Jacobian (m, 25) of the aiding with this rank at the nominal state x (26,)."""
    if rank == gnss_position.RANK:
        return gnss_position.model(x, u, z, parameters)
    if rank == gnss_velocity.RANK:
        return gnss_velocity.model(x, u, z, parameters)
    if rank == heading.RANK:
        return heading.model(x, u, z, parameters)
    if rank == zero_velocity.RANK:
        return zero_velocity.model(x, u, z, parameters)
    if rank == magnetometer.RANK:
        return magnetometer.model(x, u, z, parameters)
    if rank == zero_rate.RANK:
        return zero_rate.model(x, u, z, parameters)
    if rank == baro.RANK:
        return baro.model(x, u, z, parameters)
    if rank == gravity_tilt.RANK:
        return gravity_tilt.model(x, u, z, parameters)
    if rank == nonholonomic.RANK:
        return nonholonomic.model(x, u, z, parameters)
    return np.full(len(z), np.nan), np.zeros((len(z), CANONICAL_SIZE))


@kernel
def residuals(
    rank: int, X: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> FloatArray:
    """Residuals (k, m) of the aiding with this rank at the nominal states X (k, 26)."""
    out = np.empty((len(X), len(z)))
    for k in range(len(X)):
        out[k] = linearize(rank, X[k], u, z, parameters)[0]
    return out
