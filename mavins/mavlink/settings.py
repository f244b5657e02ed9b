"""What the session sends, how often, to whom and as whom."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Final, Literal

from annotated_types import Ge, Gt, Le

from mavins.documented import Doc

Rate = Literal["auto"] | Annotated[float, Ge(0), Le(1000)]
Persona = Literal["vehicle", "companion"]

AS_COMPANION: Final = {
    "odometry": 25.0,
    "local_position_ned_cov": 10.0,
    "attitude_quaternion_cov": 10.0,
    "global_position_int_cov": 5.0,
    "estimator_status": 2.0,
}
"""What a companion sends unless it is told otherwise: nothing that clients would mix with the autopilot's own."""
AS_VEHICLE: Final = {
    "local_position_ned": 50.0,
    "attitude": 50.0,
    "attitude_quaternion": 50.0,
    "odometry": 25.0,
    "global_position_int": 10.0,
    "highres_imu": 10.0,
    "estimator_status": 2.0,
    "vibration": 1.0,
    "sys_status": 1.0,
    "extended_sys_state": 1.0,
    "gps_global_origin": 1.0,
    "home_position": 0.5,
}


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Messages per second to each peer; 0: off; auto: by the persona, as docs/reference/messages.md lists."""

    local_position_ned: Annotated[Rate, Doc("Position and velocity in n.", "Hz")] = "auto"
    attitude: Annotated[Rate, Doc("Roll, pitch, yaw and body rates.", "Hz")] = "auto"
    attitude_quaternion: Annotated[Rate, Doc("The same as a quaternion.", "Hz")] = "auto"
    odometry: Annotated[Rate, Doc("Pose and twist with their covariances.", "Hz")] = "auto"
    global_position_int: Annotated[Rate, Doc("Geodetic position and velocity.", "Hz")] = "auto"
    highres_imu: Annotated[Rate, Doc("The IMU with its estimated biases taken off.", "Hz")] = "auto"
    estimator_status: Annotated[Rate, Doc("Test ratios, accuracies and flags.", "Hz")] = "auto"
    local_position_ned_cov: Annotated[
        Rate, Doc("Position, velocity and acceleration in n with their covariance.", "Hz")
    ] = "auto"
    attitude_quaternion_cov: Annotated[Rate, Doc("Attitude with its covariance.", "Hz")] = "auto"
    global_position_int_cov: Annotated[
        Rate, Doc("Geodetic position and velocity with their covariance.", "Hz")
    ] = "auto"
    ekf_status_report: Annotated[
        Rate, Doc("Test ratios as ArduPilot's ground stations show them.", "Hz")
    ] = "auto"
    vibration: Annotated[Rate, Doc("The IMU's vibration and clipping.", "Hz")] = "auto"
    gps_global_origin: Annotated[Rate, Doc("The origin of n.", "Hz")] = "auto"
    home_position: Annotated[Rate, Doc("Where the first estimate was.", "Hz")] = "auto"
    sys_status: Annotated[Rate, Doc("Sensor health.", "Hz")] = "auto"
    extended_sys_state: Annotated[Rate, Doc("On the ground or in the air.", "Hz")] = "auto"
    system_time: Annotated[
        Rate, Doc("The vehicle's UTC and boot time; never towards an autopilot.", "Hz")
    ] = "auto"

    def rates(self, persona: Persona) -> dict[str, float]:
        """The rate of each message in Hz."""
        usual = AS_COMPANION if persona == "companion" else AS_VEHICLE
        wanted = {f.name: getattr(self, f.name) for f in fields(self)}
        return {
            name: usual.get(name, 0.0) if rate == "auto" else float(rate)
            for name, rate in wanted.items()
        }


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Our place in the MAVLink network."""

    persona: Annotated[
        Persona,
        Doc(
            "vehicle: a vehicle of our own beside the one we listen to; companion: a component of that one, "
            "which sends ODOMETRY and covariances."
        ),
    ] = "vehicle"
    sysid: Annotated[
        Literal["auto"] | Annotated[int, Ge(1), Le(255)],
        Doc(
            "Our system id as a vehicle, for one vehicle; auto: 1 + (the vehicle's + 98) modulo 250, the next "
            "free one."
        ),
    ] = "auto"
    compid: Annotated[
        Literal["auto"] | Annotated[int, Ge(1), Le(255)],
        Doc("Our component id; auto: 1 as a vehicle, 191 (onboard computer) as a companion."),
    ] = "auto"
    allow_remote_config: Annotated[
        bool,
        Doc("Take requests that change our state from other hosts too, not from this one only."),
    ] = False
    route: Annotated[
        bool, Doc("Forward packets between peers, so that one link serves a ground station and us.")
    ] = False
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


WishedRate = Annotated[float, Ge(0), Le(1000)]


@dataclass(frozen=True, slots=True)
class AskingSettings:
    """What an autopilot is asked for where less of it comes; a rate of 0: it is not asked."""

    enabled: Annotated[
        bool,
        Doc("Ask autopilots for the messages below (SET_MESSAGE_INTERVAL) and for their time."),
    ] = True
    imu_rate: Annotated[WishedRate, Doc("HIGHRES_IMU, or the IMU message that is used.", "Hz")] = (
        200.0
    )
    gnss_rate: Annotated[WishedRate, Doc("GPS_RAW_INT, or the receiver that is used.", "Hz")] = 5.0
    attitude_rate: Annotated[WishedRate, Doc("ATTITUDE.", "Hz")] = 10.0
    position_rate: Annotated[WishedRate, Doc("GLOBAL_POSITION_INT.", "Hz")] = 5.0
    system_time_rate: Annotated[WishedRate, Doc("SYSTEM_TIME.", "Hz")] = 1.0
