"""The settings of aidings beside GNSS and heading: zero velocity, magnetometer, barometer, habits of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt

from mavins.documented import Doc
from mavins.estimator.vectors import LeverArm, Vector3


@dataclass(frozen=True, slots=True)
class ZeroVelocitySettings:
    """Zero velocity and zero rate while the vehicle stands: before its first motion, or wherever a detector says so."""

    enabled: Annotated[bool, Doc("Use it.")] = True
    detector: Annotated[
        Literal["start", "shoe", "ared", "amvd", "mag", "gnss_speed"],
        Doc(
            "start: only before the first motion, for what flies; the others find standing at any time, for a foot, "
            "a wheel or a tool: never for what can hover."
        ),
    ] = "start"
    rate: Annotated[bool, Doc("Use the zero rate too; a standing foot still rolls.")] = True
    window: Annotated[
        float, Ge(0.01), Le(1), Doc("Length of a detector's window (not of start's).", "s")
    ] = 0.1
    threshold: Annotated[
        Literal["auto"] | Annotated[float, Gt(0)],
        Doc("A detector's statistic is smaller than this while standing; auto: follows the gait."),
    ] = "auto"
    sigma_accel: Annotated[
        float, Gt(0), Le(100), Doc("A detector's accelerometer noise, of one sample.", "m/s^2")
    ] = 0.01
    sigma_gyro: Annotated[
        float, Gt(0), Le(10), Doc("A detector's gyro noise, of one sample.", "rad/s")
    ] = 0.00175
    sigma: Annotated[
        float, Gt(0), Le(10), Doc("Noise of the pseudo-measurement, 1-sigma.", "m/s")
    ] = 0.1
    rate_sigma: Annotated[
        float,
        Gt(0),
        Le(10),
        Doc("Noise of the mean rate over 0.25 s while standing, 1-sigma.", "rad/s"),
    ] = 0.003
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas of one dimension.")] = (
        5.0
    )
    gyro_limit: Annotated[
        float,
        Gt(0),
        Le(10),
        Doc(
            "The mean rate over 0.25 s stays this near to the quiet spell's first, and below three times this.",
            "rad/s",
        ),
    ] = 0.03
    accel_limit: Annotated[
        float,
        Gt(0),
        Le(10),
        Doc(
            "The mean specific force over 0.25 s stays this near to the quiet spell's first.",
            "m/s^2",
        ),
    ] = 0.12
    speed_limit: Annotated[float, Gt(0), Le(10), Doc("The GNSS speed stays below this.", "m/s")] = (
        0.8
    )


@dataclass(frozen=True, slots=True)
class MagnetometerSettings:
    """A 3-axis magnetometer, of which the field's direction is used; its scale does not matter."""

    enabled: Annotated[
        Literal["auto"] | bool,
        Doc(
            "Use it: mag.csv in a folder of CSV files, over MAVLink what the IMU message carries beside the IMU; "
            "auto: where a folder has mag.csv and no heading.csv."
        ),
    ] = "auto"
    delay: Annotated[
        float, Ge(-1), Le(2), Doc("A reading was valid this long before its stamp.", "s")
    ] = 0.0
    max_rate: Annotated[
        float, Gt(0), Le(1000), Doc("At most this many are fused: their errors last.", "Hz")
    ] = 2.0
    sigma: Annotated[
        float, Gt(0), Le(1), Doc("Noise as a share of the field's strength, 1-sigma per axis.")
    ] = 0.15
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas of one dimension.")] = (
        5.0
    )
    rotation: Annotated[
        Literal["auto"] | Vector3,
        Doc(
            "Roll, pitch, yaw that turn the sensor's axes into the body's; auto: found in a recorded flight "
            "among the 24 mountings at right angles.",
            "rad",
        ),
    ] = "auto"
    hard_iron: Annotated[
        Literal["auto"] | Vector3,
        Doc(
            "What the vehicle itself adds, along the sensor's axes and in its unit; auto: found in a recorded flight."
        ),
    ] = "auto"
    declination_deg: Annotated[
        Literal["auto"] | Annotated[float, Ge(-180), Le(180)],
        Doc("East of true north; auto: World Magnetic Model at place and date.", "deg"),
    ] = "auto"
    inclination_deg: Annotated[
        Literal["auto"] | Annotated[float, Ge(-90), Le(90)],
        Doc("Below the horizontal; auto: World Magnetic Model at place and date.", "deg"),
    ] = "auto"
    date: Annotated[
        float, Ge(2010), Lt(2030), Doc("When the flight was, for the World Magnetic Model.", "year")
    ] = 2026.0


@dataclass(frozen=True, slots=True)
class BaroSettings:
    """A barometric altitude, whose level is learnt from GNSS."""

    enabled: Annotated[bool, Doc("Use it where there is one.")] = True
    delay: Annotated[
        float, Ge(-1), Le(2), Doc("A reading was valid this long before its stamp.", "s")
    ] = 0.0
    max_rate: Annotated[float, Gt(0), Le(1000), Doc("At most this many are fused.", "Hz")] = 2.0
    sigma: Annotated[float, Gt(0), Le(100), Doc("Noise, 1-sigma.", "m")] = 3.0
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas.")] = 5.0
    drift: Annotated[
        float, Ge(0), Le(10), Doc("Random walk of the difference to GNSS altitude.", "m/sqrt(s)")
    ] = 0.2


@dataclass(frozen=True, slots=True)
class GravityTiltSettings:
    """Roll and pitch from the specific force while the vehicle does not seem to accelerate or turn."""

    enabled: Annotated[bool, Doc("Use it.")] = False
    sigma: Annotated[
        float, Gt(0), Le(10), Doc("Noise of the specific force, 1-sigma per axis.", "m/s^2")
    ] = 0.5
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas of one dimension.")] = (
        5.0
    )
    accel_limit: Annotated[
        float,
        Gt(0),
        Le(10),
        Doc("The mean specific force over 0.25 s has gravity's size to within this.", "m/s^2"),
    ] = 0.2
    gyro_limit: Annotated[
        float, Gt(0), Le(10), Doc("The mean rate over 0.25 s stays below this.", "rad/s")
    ] = 0.1


@dataclass(frozen=True, slots=True)
class NonholonomicSettings:
    """A wheeled vehicle moves neither sideways nor up or down at the axle that does not steer."""

    enabled: Annotated[bool, Doc("Use it.")] = False
    lever_arm: Annotated[LeverArm, Doc("From the IMU to that axle, body frame.", "m")] = (
        0.0,
        0.0,
        0.0,
    )
    sigma: Annotated[float, Gt(0), Le(10), Doc("Noise, 1-sigma per axis.", "m/s")] = 0.1
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas of one dimension.")] = (
        5.0
    )
