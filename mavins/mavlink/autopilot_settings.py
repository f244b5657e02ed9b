"""What an autopilot is given, and when its own estimate is said to differ from ours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from mavins.documented import Doc

Output = Literal["off", "odometry", "vision_position_estimate", "gps_input"]


@dataclass(frozen=True, slots=True)
class AutopilotOutputSettings:
    """What the vehicle's autopilot gets as an external measurement; see docs/autopilots.md before turning it on."""

    output: Annotated[
        Output,
        Doc(
            "Off, because an autopilot with the same GNSS and IMU counts them twice. odometry and "
            "vision_position_estimate go to PX4 and ArduPilot, gps_input to ArduPilot."
        ),
    ] = "off"
    rate: Annotated[
        float,
        Ge(4),
        Le(50),
        Doc("PX4 wants 30 to 50, ArduPilot 4 to 50, for gps_input 5 to 10.", "Hz"),
    ] = 30.0
    gps_id: Annotated[
        int,
        Ge(0),
        Le(3),
        Doc("The receiver that gps_input is: 0 with GPS1_TYPE 14, 1 with GPS2_TYPE 14."),
    ] = 0


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """When the autopilot's own estimate is said to differ from ours.

    The limit of a quantity is what the autopilot may be off by, plus `sigmas` times our own 1-sigma.
    """

    enabled: Annotated[
        Literal["auto"] | bool,
        Doc("auto: for PX4 and ArduPilot; others are taken to send sensors, not an estimate."),
    ] = "auto"
    sigmas: Annotated[float, Ge(0), Le(10), Doc("Our own share of a limit, in sigmas.")] = 3.0
    after: Annotated[
        float, Ge(0), Le(60), Doc("Beyond a limit for this long is worth a warning.", "s")
    ] = 3.0
    position: Annotated[float, Gt(0), Doc("The autopilot's horizontal position.", "m")] = 3.0
    height: Annotated[float, Gt(0), Doc("Its altitude.", "m")] = 5.0
    velocity: Annotated[float, Gt(0), Doc("Its velocity.", "m/s")] = 1.0
    tilt_deg: Annotated[float, Gt(0), Le(90), Doc("Its roll and pitch.", "deg")] = 5.0
    yaw_deg: Annotated[float, Gt(0), Le(180), Doc("Its yaw.", "deg")] = 10.0
