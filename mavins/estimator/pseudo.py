"""Measurements without a sensor: what is known of how a vehicle moves. Each is off until it is switched on.

Theory: docs/theory/gravity_tilt.md, docs/theory/nonholonomic.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding import Measurement, gravity_tilt, nonholonomic
from mavins.estimator.aiding_settings import GravityTiltSettings, NonholonomicSettings
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.standing import HALF_WINDOW_US, mean_rows
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.types import FloatArray


def gravity_tilt_at(
    now_us: int, buffer: ImuBuffer, frame: TangentFrame, settings: GravityTiltSettings
) -> Measurement | None:
    """The mean specific force of the last half second, valid in its middle; None while accelerating or turning."""
    if not settings.enabled:
        return None
    middle_us = now_us - HALF_WINDOW_US
    start, middle = buffer.row_after(middle_us - HALF_WINDOW_US), buffer.row_after(middle_us)
    if middle == start or middle == buffer.end:
        return None
    halves = (
        mean_rows(buffer.readings(start, middle)),
        mean_rows(buffer.readings(middle, buffer.end)),
    )
    g = _length(gravity_n(np.zeros(3), frame.r0_e, frame.C_ne))
    for mean in halves:
        if abs(_length(mean[3:]) - g) > settings.accel_limit:
            return None
        if _length(mean[:3]) > settings.gyro_limit:
            return None
    accel_b = 0.5 * (halves[0][3:] + halves[1][3:])
    return gravity_tilt.measure(now_us, middle_us, accel_b, frame, settings.sigma, settings.gate)


def nonholonomic_at(now_us: int, settings: NonholonomicSettings) -> Measurement | None:
    """Rolling without slip at the newest IMU sample."""
    if not settings.enabled:
        return None
    lever_b = np.array(settings.lever_arm)
    return nonholonomic.measure(now_us, now_us, lever_b, settings.sigma, settings.gate)


def _length(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))
