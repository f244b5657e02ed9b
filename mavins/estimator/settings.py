"""The estimator's settings. Defaults fit a vibrating multicopter with a MEMS IMU; SI units and radians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from mavins.documented import Doc
from mavins.estimator.aiding_settings import (
    BaroSettings,
    GravityTiltSettings,
    MagnetometerSettings,
    NonholonomicSettings,
    ZeroVelocitySettings,
)
from mavins.estimator.vectors import LeverArm, Vector3
from mavins.filters.settings import FilterSettings
from mavins.nav.layout import CORE, Layout


@dataclass(frozen=True, slots=True)
class ImuSettings:
    """The inertial sensor: mounting, timing and noise."""

    rotation: Annotated[
        Vector3,
        Doc(
            "Roll, pitch, yaw that turn the sensor's axes into the body's (forward, right, down).",
            "rad",
        ),
    ] = (0.0, 0.0, 0.0)
    delay: Annotated[
        float, Ge(-1), Le(1), Doc("A sample was valid this long before its stamp.", "s")
    ] = 0.0
    gyro_noise: Annotated[float, Gt(0), Le(10), Doc("Gyro noise density.", "rad/s/sqrt(Hz)")] = (
        0.015
    )
    accel_noise: Annotated[
        float, Gt(0), Le(100), Doc("Accelerometer noise density.", "m/s^2/sqrt(Hz)")
    ] = 0.35
    gyro_bias_walk: Annotated[
        float, Ge(0), Le(1), Doc("Random walk of the gyro bias.", "rad/s^2/sqrt(Hz)")
    ] = 1e-4
    accel_bias_walk: Annotated[
        float, Ge(0), Le(10), Doc("Random walk of the accelerometer bias.", "m/s^3/sqrt(Hz)")
    ] = 3e-3
    gyro_bias_sigma: Annotated[
        float, Gt(0), Le(1), Doc("Gyro bias at start, 1-sigma.", "rad/s")
    ] = 0.01
    accel_bias_sigma: Annotated[
        float, Gt(0), Le(10), Doc("Accelerometer bias at start, 1-sigma.", "m/s^2")
    ] = 0.2


@dataclass(frozen=True, slots=True)
class GnssSettings:
    """GNSS noise, timing, antenna and quality gate."""

    delay: Annotated[
        Literal["auto"] | Annotated[float, Ge(-1), Le(2)],
        Doc(
            "A fix was valid this long before its stamp; auto: 0.14 s on ArduPilot, 0 on others.",
            "s",
        ),
    ] = "auto"
    utc_delay: Annotated[
        float,
        Ge(-1),
        Le(2),
        Doc("The same for fixes that are stamped in UTC by the receiver.", "s"),
    ] = 0.0
    lever_arm: Annotated[LeverArm, Doc("From the IMU to the antenna, body frame.", "m")] = (
        0.0,
        0.0,
        0.0,
    )
    accuracy: Annotated[
        Literal["reported", "configured"],
        Doc(
            "reported: the receiver's own accuracies, where it reports them, no smaller than the floors; configured: "
            "position_sigma, altitude_sigma and velocity_sigma in their place, whatever is reported, without a floor."
        ),
    ] = "reported"
    position_floor: Annotated[
        float, Gt(0), Le(1000), Doc("The position sigma is never taken smaller than this.", "m")
    ] = 0.5
    velocity_floor: Annotated[
        float, Gt(0), Le(100), Doc("The velocity sigma is never taken smaller than this.", "m/s")
    ] = 0.3
    rtk_position_floor: Annotated[
        float, Gt(0), Le(1000), Doc("The same for RTK fixes (fix types 5 and 6).", "m")
    ] = 0.05
    rtk_velocity_floor: Annotated[float, Gt(0), Le(100), Doc("The same for RTK fixes.", "m/s")] = (
        0.1
    )
    position_sigma: Annotated[
        float,
        Gt(0),
        Le(1000),
        Doc("Horizontal position sigma where the receiver reports none.", "m"),
    ] = 1.5
    altitude_sigma: Annotated[
        float, Gt(0), Le(1000), Doc("Vertical position sigma where the receiver reports none.", "m")
    ] = 2.5
    velocity_sigma: Annotated[
        float, Gt(0), Le(100), Doc("Velocity sigma where the receiver reports none.", "m/s")
    ] = 0.5
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas of one dimension.")] = (
        5.0
    )
    min_satellites: Annotated[
        int, Ge(0), Le(50), Doc("Fewer satellites than this are not trusted (unknown is).")
    ] = 6
    max_sigma_h: Annotated[
        float, Gt(0), Le(1000), Doc("A worse reported horizontal accuracy is not trusted.", "m")
    ] = 5.0
    max_sigma_v: Annotated[
        float, Gt(0), Le(1000), Doc("A worse reported vertical accuracy is not trusted.", "m")
    ] = 8.0
    max_sigma_speed: Annotated[
        float, Gt(0), Le(100), Doc("A worse reported speed accuracy is not trusted.", "m/s")
    ] = 2.0
    good_fixes: Annotated[
        int, Ge(1), Le(100), Doc("This many good fixes in a row before the first is used.")
    ] = 3
    max_standing_speed: Annotated[
        float, Gt(0), Le(10), Doc("A faster fix while the vehicle stands is not good.", "m/s")
    ] = 0.8
    max_standing_drift: Annotated[
        float,
        Gt(0),
        Le(100),
        Doc("A fix that wanders faster than this while the vehicle stands is not good.", "m/s"),
    ] = 2.0
    reset_after: Annotated[
        float,
        Gt(0),
        Le(600),
        Doc("Position or velocity rejected for longer than this is reset to GNSS.", "s"),
    ] = 7.0


@dataclass(frozen=True, slots=True)
class HeadingSettings:
    """Heading noise, timing and gate."""

    delay: Annotated[
        float, Ge(-1), Le(2), Doc("A heading was valid this long before its stamp.", "s")
    ] = 0.0
    max_rate: Annotated[
        Literal["auto"] | Annotated[float, Gt(0), Le(1000)],
        Doc(
            "At most this many are fused; auto: 5 from an autopilot's own estimate, whose error lasts for "
            "seconds, all from a sensor.",
            "Hz",
        ),
    ] = "auto"
    accuracy: Annotated[
        Literal["reported", "configured"],
        Doc(
            "reported: the source's own sigma, where it reports one; configured: sigma_deg in its place."
        ),
    ] = "reported"
    sigma_deg: Annotated[float, Gt(0), Le(180), Doc("Heading noise, 1-sigma.", "deg")] = 3.0
    gate: Annotated[float, Gt(0), Le(100), Doc("Innovation gate, in sigmas.")] = 5.0
    from_motion: Annotated[
        bool,
        Doc("Without a heading, start with the yaw that GNSS velocity shows; reset a wrong yaw."),
    ] = True


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """How the first attitude is found."""

    window: Annotated[float, Gt(0), Le(10), Doc("The IMU is averaged over this long.", "s")] = 1.0
    heading_age: Annotated[float, Gt(0), Le(10), Doc("An older heading does not align.", "s")] = 1.0
    moving_sigma_deg: Annotated[
        float, Gt(0), Le(90), Doc("Extra roll and pitch sigma when levelled in motion.", "deg")
    ] = 4.0


@dataclass(frozen=True, slots=True)
class StatesSettings:
    """What is estimated beside position, velocity, attitude and biases."""

    lever_arm: Annotated[
        Literal["estimate", "fixed"],
        Doc("The GNSS antenna's place, from gnss.lever_arm on; it shows when the vehicle turns."),
    ] = "fixed"
    lever_arm_sigma: Annotated[
        float, Gt(0), Le(100), Doc("The lever arm at start, 1-sigma on each axis.", "m")
    ] = 0.5
    gnss_delay: Annotated[
        Literal["estimate", "fixed"],
        Doc("The delay of GNSS, from gnss.delay on; it shows when the vehicle accelerates."),
    ] = "estimate"
    gnss_delay_sigma: Annotated[float, Gt(0), Le(1), Doc("The delay at start, 1-sigma.", "s")] = 0.1
    baro_bias: Annotated[
        Literal["estimate", "fixed"],
        Doc("The barometer's level, from its first difference to GNSS on; else tracked beside."),
    ] = "fixed"
    baro_bias_sigma: Annotated[
        float, Gt(0), Le(1000), Doc("The barometer's level at start, 1-sigma.", "m")
    ] = 5.0
    baro_bias_walk: Annotated[
        float, Ge(0), Le(10), Doc("Random walk of the barometer's level.", "m/sqrt(s)")
    ] = 0.2
    mag_bias: Annotated[
        Literal["estimate", "fixed"],
        Doc("The magnetometer's hard iron beside magnetometer.hard_iron; it shows in turns."),
    ] = "fixed"
    mag_bias_sigma: Annotated[
        float,
        Gt(0),
        Le(10),
        Doc("Hard iron at start, a share of the Earth's field, 1-sigma on each axis."),
    ] = 0.1
    mag_bias_walk: Annotated[
        float, Ge(0), Le(1), Doc("Random walk of hard iron, such a share each.", "1/sqrt(s)")
    ] = 1e-4
    gravity: Annotated[
        Literal["estimate", "fixed"],
        Doc(
            "How gravity's direction differs from normal gravity's, from nothing on; it shows in turns "
            "and with a good heading (eskf, iekf, ieskf)."
        ),
    ] = "fixed"
    gravity_sigma_deg: Annotated[
        float, Gt(0), Le(10), Doc("That difference at start, 1-sigma about north and east.", "deg")
    ] = 1.0

    def layout(self) -> Layout:
        """The error states that this makes."""
        extra = {
            "l_b": self.lever_arm,
            "tau": self.gnss_delay,
            "b_baro": self.baro_bias,
            "b_m": self.mag_bias,
            "g_n": self.gravity,
        }
        return Layout.of((*CORE, *(block for block, how in extra.items() if how == "estimate")))

    def walks(self) -> dict[str, float]:
        """Root PSDs of the random walks of these states, by block; the others are constant."""
        return {"b_baro": self.baro_bias_walk, "b_m": self.mag_bias_walk}


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Time ordering and health."""

    buffer: Annotated[
        float,
        Gt(0),
        Le(30),
        Doc("A measurement may be this late and still be fused where it belongs.", "s"),
    ] = 1.0
    max_gap: Annotated[
        float, Gt(0.2), Le(60), Doc("A longer gap between IMU samples starts a new alignment.", "s")
    ] = 2.0
    dead_reckoning_after: Annotated[
        float,
        Gt(0),
        Le(600),
        Doc("Without an accepted GNSS measurement for this long: dead reckoning.", "s"),
    ] = 2.5
    max_position_sigma: Annotated[
        float, Gt(0), Doc("A larger horizontal 1-sigma means that the filter is lost.", "m")
    ] = 10000.0


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything that the estimator is told."""

    imu: ImuSettings = ImuSettings()
    gnss: GnssSettings = GnssSettings()
    heading: HeadingSettings = HeadingSettings()
    zero_velocity: ZeroVelocitySettings = ZeroVelocitySettings()
    states: StatesSettings = StatesSettings()
    magnetometer: MagnetometerSettings = MagnetometerSettings()
    baro: BaroSettings = BaroSettings()
    gravity_tilt: GravityTiltSettings = GravityTiltSettings()
    nonholonomic: NonholonomicSettings = NonholonomicSettings()
    alignment: AlignmentSettings = AlignmentSettings()
    estimator: EstimatorSettings = EstimatorSettings()
    filters: FilterSettings = FilterSettings()
