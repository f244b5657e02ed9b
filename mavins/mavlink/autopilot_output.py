"""What an autopilot is given as a measurement of its own, where the user wants that. See docs/autopilots.md."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from mavins.estimator.estimator import Estimator
from mavins.mavlink.autopilot_settings import AutopilotOutputSettings
from mavins.mavlink.clock import Clock
from mavins.mavlink.codec import (
    Payload,
    gps_input,
    odometry_for_ardupilot,
    odometry_for_px4,
    vision_position_estimate,
)
from mavins.mavlink.sources import ARDUPILOT, PX4
from mavins.mavlink.streams import quality_of
from mavins.types import NavSolution

UNKNOWN_SATELLITES: Final = 255


class AutopilotOutput:
    """Says which payloads are due to one vehicle's autopilot as its clock moves on."""

    def __init__(self, settings: AutopilotOutputSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._period_us = round(1e6 / settings.rate)
        self._before_us: int | None = None

    def refusal(self, autopilot: int | None) -> str:
        """Why nothing is sent to a vehicle with this MAV_AUTOPILOT although the user wants it; else empty."""
        output = self._settings.output
        if output == "off" or autopilot is None:
            return ""
        if output == "gps_input" and autopilot != ARDUPILOT:
            return "only ArduPilot takes GPS_INPUT"
        if autopilot not in (ARDUPILOT, PX4):
            return f"neither PX4 nor ArduPilot: it gets no {output.upper()}"
        if output == "gps_input" and self._unix_us() is None:
            return "GPS_INPUT waits for UTC: the vehicle sends no SYSTEM_TIME with it"
        return ""

    def due(
        self,
        estimator: Estimator,
        autopilot: int | None,
        satellites: int | None = None,
    ) -> Iterator[Payload]:
        """What falls due at the estimator's newest instant, for the vehicle's own address alone.

        Stamps are on the clock of our reception stamps, which is the one that TIMESYNC answers tell: PX4 takes the
        difference off again. `satellites` is what the vehicle's receiver reported last.
        """
        t_us = estimator.t_us
        if (
            self._settings.output == "off"
            or autopilot is None
            or t_us is None
            or not estimator.running
            or self.refusal(autopilot)
        ):
            return
        before, self._before_us = self._before_us, t_us
        if before is not None and t_us // self._period_us == before // self._period_us:
            return
        solution = estimator.solution()
        if solution is not None:
            yield self._make(solution, autopilot, t_us + self._clock.lag_us, satellites)

    def _make(
        self, solution: NavSolution, autopilot: int, stamp_us: int, satellites: int | None
    ) -> Payload:
        match self._settings.output:
            case "vision_position_estimate":
                return vision_position_estimate(solution, stamp_us)
            case "gps_input":
                unix_us = self._unix_us()
                assert unix_us is not None
                count = UNKNOWN_SATELLITES if satellites is None else satellites
                return gps_input(solution, stamp_us, unix_us, self._settings.gps_id, count)
            case _:
                make = odometry_for_px4 if autopilot == PX4 else odometry_for_ardupilot
                return make(solution, stamp_us, quality_of(solution))

    def _unix_us(self) -> int | None:
        newest_us = self._clock.newest_us
        return None if newest_us is None else self._clock.unix_of(newest_us)
