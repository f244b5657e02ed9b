"""IMU rows on their way in: turned into b, put at their valid times, and cut where something must be looked at."""

from __future__ import annotations

import numpy as np

from mavins.nav.kernels import kernel
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import FloatArray, ImuTable, IntArray

TICK_US = 200_000
"""Standing, time-outs and health are looked at when the IMU stamps pass a multiple of this."""


def turn_of(angles: tuple[float, float, float]) -> FloatArray | None:
    """C_bs (3, 3) of a mounting given by roll, pitch, yaw; None where the axes are the body's."""
    return None if angles == (0.0, 0.0, 0.0) else quat_to_dcm(euler_to_quat(*angles))


@kernel
def run_end(t_us: IntArray, start: int, newest_us: int, max_gap_us: int) -> int:
    """Where the run of stamps t_us (N,) from `start` ends: after the first one past a tick, before disorder or a gap.

    `newest_us` is the stamp before the run, -1 for none.
    """
    last = t_us[start]
    if newest_us >= 0 and last // TICK_US != newest_us // TICK_US:
        return start + 1
    end = start + 1
    while end < len(t_us):
        t = t_us[end]
        if t <= last or t - last > max_gap_us:
            break
        end += 1
        if t // TICK_US != last // TICK_US:
            break
        last = t
    return end


@kernel
def _rotate_rows(C: FloatArray, imu: FloatArray) -> FloatArray:
    """Rows (N, 6) of two vectors each, turned by C (3, 3); a loop, so that a row does not depend on its neighbours."""
    out = np.zeros(imu.shape)
    for k in range(imu.shape[0]):
        for i in range(3):
            for j in range(3):
                out[k, i] += C[i, j] * imu[k, j]
                out[k, 3 + i] += C[i, j] * imu[k, 3 + j]
    return out


def to_body(
    table: ImuTable, delay_us: int, rotation: FloatArray | None
) -> tuple[IntArray, FloatArray]:
    """Valid times (N,) and readings [gyro_b, accel_b] (N, 6) of a table."""
    imu = np.empty((len(table), 6))
    imu[:, :3] = table.gyro_b
    imu[:, 3:] = table.accel_b
    t_us = table.t_us - delay_us if delay_us else table.t_us
    return t_us, imu if rotation is None else _rotate_rows(rotation, imu)
