"""Which messages feed the estimator: what the user asked for, resolved by the autopilot that is there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from mavins.documented import Doc
from mavins.estimator.settings import GnssSettings, HeadingSettings

ARDUPILOT: Final = 3
PX4: Final = 12
"""Numbers of MAV_AUTOPILOT whose ATTITUDE and GLOBAL_POSITION_INT are a filter's output, not a sensor's."""

GnssSource = Literal["gps_raw_int", "global_position_int", "gps_input", "hil_gps", "gps2_raw"]
HeadingSource = Literal["attitude", "gps_yaw", "off"]
VerticalSource = Literal["global_position_int", "off"]


@dataclass(frozen=True, slots=True)
class SourceSettings:
    """Which messages are used; auto goes by the autopilot named in HEARTBEAT."""

    gnss: Annotated[
        Literal["auto"] | GnssSource,
        Doc(
            "Position and velocity; auto: gps_raw_int from PX4 and ArduPilot, else global_position_int; "
            "gps2_raw: an autopilot's second receiver."
        ),
    ] = "auto"
    vertical_velocity: Annotated[
        Literal["auto"] | VerticalSource,
        Doc(
            "Vertical velocity beside GPS_RAW_INT and GPS2_RAW, which have none; auto: off, because an autopilot's "
            "GLOBAL_POSITION_INT is the output of its own filter."
        ),
    ] = "auto"
    heading: Annotated[
        Literal["auto"] | HeadingSource,
        Doc("Heading; auto: ATTITUDE.yaw; gps_yaw: two antennas of the receiver that is used."),
    ] = "auto"


@dataclass(frozen=True, slots=True)
class Sources:
    """The resolved sources. Delays in s; `heading_rate` in Hz, None for no limit."""

    gnss: GnssSource
    heading: HeadingSource
    vertical_velocity: bool
    gnss_delay: float
    utc_delay: float
    heading_delay: float
    heading_rate: float | None

    @property
    def receiver(self) -> str:
        """The message of the autopilot's receiver that is looked at; the other one is not."""
        return "GPS2_RAW" if self.gnss == "gps2_raw" else "GPS_RAW_INT"


def resolve(
    wanted: SourceSettings, gnss: GnssSettings, heading: HeadingSettings, autopilot: int
) -> Sources:
    """The sources for a vehicle with this MAV_AUTOPILOT."""
    has_filter = autopilot in (ARDUPILOT, PX4)
    gnss_source: GnssSource = "gps_raw_int" if has_filter else "global_position_int"
    heading_source: HeadingSource = "attitude"
    if wanted.gnss != "auto":
        gnss_source = wanted.gnss
    if wanted.heading != "auto":
        heading_source = wanted.heading
    delay = gnss.delay
    if delay == "auto":
        delay = 0.14 if autopilot == ARDUPILOT else 0.0
    limit: float | None = None
    if heading.max_rate != "auto":
        limit = heading.max_rate
    elif has_filter and heading_source == "attitude":
        limit = 5.0
    vertical = wanted.vertical_velocity
    return Sources(
        gnss_source,
        heading_source,
        gnss_source == "global_position_int" if vertical == "auto" else vertical != "off",
        delay,
        gnss.utc_delay,
        heading.delay,
        limit,
    )
