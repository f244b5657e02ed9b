"""The words that the rooms of mavins speak to each other: frozen data, SI units and radians.

Frames and names are those of docs/architecture.md: n is the tangent NED frame at the origin, l the
local level NED frame at the vehicle, b the body frame (forward, right, down). `t_us` is always an
integer number of microseconds on the vehicle's IMU time base.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]

RTK_FIX_TYPES: Final = (5, 6)


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One IMU sample: specific force `accel_b` (m/s^2) and angular rate `gyro_b` (rad/s), body frame, shape (3,)."""

    t_us: int
    accel_b: FloatArray
    gyro_b: FloatArray


@dataclass(frozen=True, slots=True)
class ImuTable:
    """Consecutive IMU samples as rows: `t_us` (N,) int64, `accel_b` (N, 3) m/s^2, `gyro_b` (N, 3) rad/s.

    Live feeds tables of one row, replay tables of many; both take the same way through the estimator.
    """

    t_us: IntArray
    accel_b: FloatArray
    gyro_b: FloatArray

    def __len__(self) -> int:
        return len(self.t_us)

    def __getitem__(self, rows: slice | IntArray) -> ImuTable:
        """Some of the rows."""
        return ImuTable(self.t_us[rows], self.accel_b[rows], self.gyro_b[rows])


@dataclass(frozen=True, slots=True)
class GnssFix:
    """One GNSS fix.

    `lat`, `lon` in radians, `alt` in m above mean sea level; `v_l` is the NED velocity in m/s in the local
    level frame with NaN where a component is not measured (GPS_RAW_INT has no vertical one), or None.
    The sigmas are the receiver's own claims in m and m/s, None where it makes none. `t_us` is the stamp
    of the message; the fix was valid at t_us - delay (s).
    """

    t_us: int
    lat: float
    lon: float
    alt: float
    v_l: tuple[float, float, float] | None
    fix_type: int
    satellites: int | None = None
    sigma_h: float | None = None
    sigma_v: float | None = None
    sigma_speed: float | None = None
    source: str = "gnss"
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class HeadingFix:
    """One heading (yaw of the body's forward axis from true north, radians, local level frame).

    `sigma` in radians is the source's own claim, or None for the configured one. Valid at t_us - delay (s).
    """

    t_us: int
    yaw: float
    sigma: float | None = None
    source: str = "heading"
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class MagSample:
    """One reading of a 3-axis magnetometer: `field` (3,) along the sensor's axes, in any unit."""

    t_us: int
    field: FloatArray
    source: str = "magnetometer"


@dataclass(frozen=True, slots=True)
class BaroSample:
    """One barometric altitude in m, above whatever level its maker chose."""

    t_us: int
    alt: float
    source: str = "baro"


Reading: TypeAlias = HeadingFix | MagSample | BaroSample
"""What a sensor other than IMU and GNSS says."""


class Health(enum.IntEnum):
    """What the estimator is doing. Only RUNNING and DEAD_RECKONING have an estimate to give."""

    WAITING = 0
    ALIGNING = 1
    RUNNING = 2
    DEAD_RECKONING = 3
    DIVERGED = 4


@dataclass(frozen=True, slots=True)
class Origin:
    """The origin of frame n: geodetic `lat`, `lon` in radians, `alt` in m above mean sea level."""

    lat: float
    lon: float
    alt: float


@dataclass(frozen=True, slots=True)
class NavSolution:
    """The navigation solution at one instant.

    `p_n`, `v_n` (3,) m, m/s in n; `q_nb` (4,) scalar-first Hamilton quaternion taking b to n. `v_l` and
    `q_lb` are the same velocity and attitude in the local level frame, `roll`, `pitch`, `yaw` its
    Euler angles (Z-Y-X). `w_b` rad/s and `f_b` m/s^2 are the bias-corrected IMU readings, `b_g`, `b_a` the biases.
    `P` (15, 15) is the covariance of the canonical errors p_n, v_n, theta_b, b_g, b_a.
    `sd_euler` (3,) are the sigmas of roll, pitch, yaw. `l_b` (3,) m is the lever arm and `tau` s the delay of GNSS,
    `b_baro` m the bias of the barometer, `b_m` (3,) that of the magnetometer, a share of the Earth's field, and `g_n`
    (2,) rad the turn of normal gravity about north and east; with their sigmas, which are zero where they are not
    estimated.
    """

    t_us: int
    lat: float
    lon: float
    alt: float
    p_n: FloatArray
    v_n: FloatArray
    q_nb: FloatArray
    v_l: FloatArray
    q_lb: FloatArray
    roll: float
    pitch: float
    yaw: float
    w_b: FloatArray
    f_b: FloatArray
    b_g: FloatArray
    b_a: FloatArray
    P: FloatArray
    sd_euler: FloatArray
    l_b: FloatArray
    sd_l_b: FloatArray
    tau: float
    sd_tau: float
    b_baro: float
    sd_b_baro: float
    b_m: FloatArray
    sd_b_m: FloatArray
    g_n: FloatArray
    sd_g_n: FloatArray
    health: Health
    reset_counter: int


@dataclass(frozen=True, slots=True)
class TruthSample:
    """A simulator's truth, for evaluation only; frames and units as in NavSolution, velocity and attitude in l."""

    t_us: int
    lat: float
    lon: float
    alt: float
    v_l: tuple[float, float, float]
    q_lb: tuple[float, float, float, float]
