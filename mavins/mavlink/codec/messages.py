"""What the decoders hand out: one frozen record per message, in SI units and radians, stamps as
sent.

A `stamp_us` is the sender's own: microseconds since boot or since 1970, `clock` tells which. Where
a message sends boot milliseconds, `wraps` says that its stamp starts again from zero after 2^32 ms
(49.7 days). None means that the sender does not know the value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavins.types import FloatArray, IntArray

IMU_KINDS: dict[int, str] = {
    105: "HIGHRES_IMU",
    26: "SCALED_IMU",
    116: "SCALED_IMU2",
    129: "SCALED_IMU3",
    27: "RAW_IMU",
}
"""The messages that carry an IMU sample, by message id."""

WRAPPING_IMU_KINDS = frozenset({"SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"})
"""Those of them that are stamped in boot milliseconds."""


@dataclass(frozen=True, slots=True)
class Invalid:
    """A handled message whose content cannot be used: its name and the reason, for the counters."""

    kind: str
    reason: str


@dataclass(frozen=True, slots=True)
class ImuMessage:
    """An IMU sample of message `kind`, sensor `imu_id`: specific force m/s^2, angular rate rad/s,
    (3,) in b.
    """

    kind: str
    imu_id: int
    stamp_us: int
    accel_b: FloatArray
    gyro_b: FloatArray

    @property
    def wraps(self) -> bool:
        """True where the stamp is in boot milliseconds on the wire."""
        return self.kind in WRAPPING_IMU_KINDS


@dataclass(frozen=True, slots=True)
class ImuRows:
    """N IMU samples as columns, bit for bit what the single decoder gives.

    `stamp_us` (N,), `accel_b` (N, 3) m/s^2, `gyro_b` (N, 3) rad/s, `msgid` (N,) (see IMU_KINDS),
    `imu_id` (N,); where `valid` (N,) is False the row is NaN and must not be used.
    """

    stamp_us: IntArray
    accel_b: FloatArray
    gyro_b: FloatArray
    msgid: IntArray
    imu_id: IntArray
    valid: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.stamp_us)


@dataclass(frozen=True, slots=True)
class GpsRaw:
    """GPS_RAW_INT: position (rad, rad, m above mean sea level), ground speed m/s, course over
    ground rad.

    Accuracies are 1-sigma in m, m/s and rad; `eph`, `epv` are dilutions of precision; `yaw` is the
    vehicle's heading from two antennas, rad.
    """

    wraps: ClassVar[bool] = False
    kind: ClassVar[str] = "GPS_RAW_INT"

    stamp_us: int
    fix_type: int
    lat: float
    lon: float
    alt: float
    speed: float | None
    course: float | None
    satellites: int | None
    eph: float | None
    epv: float | None
    h_acc: float | None
    v_acc: float | None
    vel_acc: float | None
    hdg_acc: float | None
    yaw: float | None


@dataclass(frozen=True, slots=True)
class Gps2Raw(GpsRaw):
    """GPS2_RAW: the same of an autopilot's second receiver."""

    kind: ClassVar[str] = "GPS2_RAW"


@dataclass(frozen=True, slots=True)
class GlobalPosition:
    """GLOBAL_POSITION_INT: position (rad, rad, m above mean sea level), NED velocity m/s, heading
    rad.
    """

    wraps: ClassVar[bool] = True
    kind: ClassVar[str] = "GLOBAL_POSITION_INT"

    stamp_us: int
    lat: float
    lon: float
    alt: float
    relative_alt: float
    v_l: tuple[float, float, float]
    heading: float | None


@dataclass(frozen=True, slots=True)
class LocalPosition:
    """LOCAL_POSITION_NED: position (m) and velocity (m/s) in a NED frame of the sender's own."""

    wraps: ClassVar[bool] = True
    kind: ClassVar[str] = "LOCAL_POSITION_NED"

    stamp_us: int
    p_n: tuple[float, float, float]
    v_n: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class GpsInput:
    """GPS_INPUT: as GpsRaw with NED velocity m/s; what `ignore_flags` rules out is None, in `v_l`
    NaN.
    """

    wraps: ClassVar[bool] = False
    kind: ClassVar[str] = "GPS_INPUT"

    stamp_us: int
    gps_id: int
    fix_type: int
    lat: float
    lon: float
    alt: float | None
    v_l: tuple[float, float, float] | None
    satellites: int | None
    hdop: float | None
    vdop: float | None
    h_acc: float | None
    v_acc: float | None
    vel_acc: float | None
    yaw: float | None


@dataclass(frozen=True, slots=True)
class HilGps:
    """HIL_GPS: position (rad, rad, m above mean sea level), NED velocity m/s, dilutions of
    precision, heading rad.
    """

    wraps: ClassVar[bool] = False
    kind: ClassVar[str] = "HIL_GPS"

    stamp_us: int
    gps_id: int
    fix_type: int
    lat: float
    lon: float
    alt: float
    v_l: tuple[float, float, float]
    satellites: int | None
    eph: float | None
    epv: float | None
    yaw: float | None


@dataclass(frozen=True, slots=True)
class Attitude:
    """ATTITUDE: Z-Y-X Euler angles in rad, `rates` of the body in rad/s."""

    wraps: ClassVar[bool] = True
    kind: ClassVar[str] = "ATTITUDE"

    stamp_us: int
    roll: float
    pitch: float
    yaw: float
    rates: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SystemTime:
    """SYSTEM_TIME: microseconds since 1970 (None while the vehicle does not know) at `boot_us`
    since boot.
    """

    wraps: ClassVar[bool] = True
    kind: ClassVar[str] = "SYSTEM_TIME"

    unix_us: int | None
    boot_us: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT: the numbers of MAV_TYPE, MAV_AUTOPILOT, MAV_MODE_FLAG, MAV_STATE and the
    autopilot's own mode.
    """

    kind: ClassVar[str] = "HEARTBEAT"

    type: int
    autopilot: int
    base_mode: int
    system_status: int
    custom_mode: int


@dataclass(frozen=True, slots=True)
class OriginRequest:
    """SET_GPS_GLOBAL_ORIGIN: the wanted origin of frame n (rad, rad, m above mean sea level)."""

    kind: ClassVar[str] = "SET_GPS_GLOBAL_ORIGIN"

    target_system: int
    lat: float
    lon: float
    alt: float


@dataclass(frozen=True, slots=True)
class HilState:
    """HIL_STATE_QUATERNION, a simulator's truth: for evaluation only. Velocity m/s and attitude in
    l, rates rad/s.
    """

    kind: ClassVar[str] = "HIL_STATE_QUATERNION"

    stamp_us: int
    lat: float
    lon: float
    alt: float
    v_l: tuple[float, float, float]
    q_lb: tuple[float, float, float, float]
    rates: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SimState:
    """SIM_STATE, ArduPilot's truth: for evaluation only. It has no stamp; velocity m/s and attitude
    in l.
    """

    kind: ClassVar[str] = "SIM_STATE"

    lat: float
    lon: float
    alt: float
    v_l: tuple[float, float, float]
    q_lb: tuple[float, float, float, float]


Message: TypeAlias = (
    ImuMessage
    | GpsRaw
    | GlobalPosition
    | LocalPosition
    | GpsInput
    | HilGps
    | Attitude
    | SystemTime
    | Heartbeat
    | OriginRequest
)
Truth: TypeAlias = HilState | SimState
