"""What the session sends, how often and to whom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from mavins.documented import Doc

Rate = Annotated[float, Ge(0), Le(1000)]


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Messages per second to every peer, on the vehicle's clock; 0 turns a message off."""

    local_position_ned: Annotated[Rate, Doc("Position and velocity in n.", "Hz")] = 50.0
    attitude: Annotated[Rate, Doc("Roll, pitch, yaw and body rates.", "Hz")] = 50.0
    attitude_quaternion: Annotated[Rate, Doc("The same as a quaternion.", "Hz")] = 50.0
    odometry: Annotated[Rate, Doc("Pose and twist with their covariances.", "Hz")] = 25.0
    global_position_int: Annotated[Rate, Doc("Geodetic position and velocity.", "Hz")] = 10.0
    highres_imu: Annotated[Rate, Doc("The IMU with its estimated biases taken off.", "Hz")] = 10.0
    estimator_status: Annotated[Rate, Doc("Test ratios, accuracies and flags.", "Hz")] = 2.0
    sys_status: Annotated[Rate, Doc("Sensor health.", "Hz")] = 1.0
    gps_global_origin: Annotated[Rate, Doc("The origin of n.", "Hz")] = 1.0
    home_position: Annotated[Rate, Doc("Where the first estimate was.", "Hz")] = 0.5


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Our place in the MAVLink network."""

    sysid: Annotated[
        Literal["auto"] | Annotated[int, Ge(1), Le(255)],
        Doc(
            "Our system id, for one vehicle; auto: 1 + (the vehicle's + 98) modulo 250, the next free one."
        ),
    ] = "auto"
    peer_timeout: Annotated[
        float,
        Gt(0),
        Le(3600),
        Doc("A peer that is silent for this long receives nothing more.", "s"),
    ] = 30.0
    vehicle_timeout: Annotated[
        float,
        Gt(0),
        Le(60),
        Doc(
            "Another address may take over a vehicle's sysid when it was silent for this long.", "s"
        ),
    ] = 3.0
    max_peers: Annotated[
        int, Ge(1), Le(1000), Doc("More addresses than this are not answered.")
    ] = 32
    max_vehicles: Annotated[
        int, Ge(1), Le(250), Doc("More vehicles than this are not taken up.")
    ] = 16
