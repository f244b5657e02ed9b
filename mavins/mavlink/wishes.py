"""One message that an autopilot is wished to send: what comes of it, and what was answered to our asking."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from mavins.mavlink.codec import Payload, fields_of, payload
from mavins.mavlink.settings import AskingSettings
from mavins.mavlink.sources import ARDUPILOT, PX4

COMMAND_LONG: Final = fields_of("COMMAND_LONG")
SET_INTERVAL: Final = 511
LADDER: Final = (250.0, 200.0, 100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0)
"""The rates in Hz to which a denied wish goes down, whole milliseconds all."""
SLOWEST_IMU: Final = 50.0
ENOUGH: Final = 0.8
"""A message that comes at this part of its rate needs no asking."""
WINDOW_US: Final = 1_000_000
WINDOW_PERIODS: Final = 5
ARRIVAL_US: Final = 3_000_000
"""What was accepted must have come by then."""
LOW_AT_FIRST: Final = 2
LOW_LATER: Final = 3
"""So many windows must fall short before a message that does come is asked for: at first, and once it came."""
_BAUD_RATES: Final = (57600, 115200, 230400, 460800, 921600, 1500000, 3000000)
_HEAVY: Final = 4000.0
"""Bytes per second from which a serial line may be too slow for a message."""
_ARDUPILOT_STREAMS: Final = {
    "GPS_RAW_INT": "SRx_EXT_STAT",
    "GPS2_RAW": "SRx_EXT_STAT",
    "ATTITUDE": "SRx_EXTRA1",
    "GLOBAL_POSITION_INT": "SRx_POSITION",
    "SYSTEM_TIME": "SRx_EXTRA3",
}


class State(Enum):
    """How far we are with a wish."""

    MEASURING = auto()
    WANTED = auto()
    GRANTED = auto()
    COMING = auto()
    GIVEN_UP = auto()


@dataclass(slots=True)
class Wish:
    """Message `name` at `rates[0]` Hz or, where that is denied, at the next of `rates`.

    `measured` is what came in the last window, in Hz; `remark` says what is wrong with it, for people.
    """

    name: str
    rates: tuple[float, ...]
    is_imu: bool = False
    state: State = State.MEASURING
    step: int = 0
    measured: float = 0.0
    remark: str = ""
    granted_us: int = 0
    _low: int = 0
    _window: tuple[int, int | None, int] | None = None

    @property
    def rate(self) -> float:
        """The rate that is asked for, or was granted, in Hz."""
        return self.rates[self.step]

    @property
    def is_gnss(self) -> bool:
        """True for the message of a receiver of the autopilot's."""
        return self.name in ("GPS_RAW_INT", "GPS2_RAW")

    def grant(self, now_us: int) -> None:
        """The autopilot has accepted it; what comes is counted from now on."""
        self.state, self.granted_us, self._window = State.GRANTED, now_us, None

    def restart(self) -> None:
        """Measure and ask from the beginning."""
        self.state, self.step, self.remark = State.MEASURING, 0, ""
        self._low, self._window = 0, None

    def rename(self, name: str) -> None:
        """Another message serves the same end."""
        if name != self.name:
            self.name = name
            self.restart()

    def request(self, sysid: int, confirmation: int) -> Payload:
        """COMMAND_LONG that asks an autopilot for it, in whole milliseconds."""
        return payload(
            COMMAND_LONG,
            target_system=sysid,
            target_component=1,
            command=SET_INTERVAL,
            confirmation=confirmation,
            param1=fields_of(self.name).msgid,
            param2=max(1, int(1000.0 / self.rate)) * 1000,
        )

    def measure(self, now_us: int, vehicle_us: int | None, count: int) -> bool:
        """Look at how many have come; True when a window is over.

        Rates are counted on the vehicle's clock where it moves, so that a simulation that is slow keeps its own.
        """
        if self._window is None:
            self._window = (now_us, vehicle_us, count)
            return False
        begin_us, vehicle_begin_us, before = self._window
        elapsed_us = now_us - begin_us
        if elapsed_us < max(WINDOW_US, WINDOW_PERIODS * 1e6 / self.rates[0]):
            return False
        self._window = (now_us, vehicle_us, count)
        if vehicle_us is not None and vehicle_begin_us is not None:
            own_us = vehicle_us - vehicle_begin_us
            if 0.1 * elapsed_us < own_us < 10 * elapsed_us:
                elapsed_us = own_us
        self.measured = max(0, count - before) * 1e6 / elapsed_us
        return True

    def judge(self, now_us: int) -> str:
        """Go on by what the last window held; returns what is to be said: "comes", "short" or nothing."""
        if self.measured >= ENOUGH * self.rates[0]:
            news = "comes" if self.remark else ""
            self.state, self.step, self.remark, self._low = State.COMING, 0, "", 0
            return news
        enough = self.measured >= ENOUGH * self.rate
        self._low = 0 if enough else self._low + 1
        if self.state is State.MEASURING:
            if self.measured == 0.0 or self._low >= LOW_AT_FIRST:
                self.state = State.WANTED
        elif self.state is State.GRANTED:
            if enough:
                self.state = State.COMING
            elif now_us - self.granted_us >= ARRIVAL_US:
                self.state = State.GIVEN_UP
                return "short"
        elif self.state is State.COMING and self._low >= LOW_LATER:
            self.state, self.step, self._low = State.WANTED, 0, 0
        return ""

    def slower(self) -> bool:
        """Go down to the next rate that is more than what comes anyhow; False where there is none."""
        if self.step + 1 < len(self.rates) and self.rates[self.step + 1] * ENOUGH > self.measured:
            self.step += 1
            return True
        return False


def wishes_of(settings: AskingSettings) -> list[Wish]:
    """The wishes that an autopilot is asked for, the most needed first."""
    wanted = (
        ("HIGHRES_IMU", settings.imu_rate),
        ("GPS_RAW_INT", settings.gnss_rate),
        ("ATTITUDE", settings.attitude_rate),
        ("GLOBAL_POSITION_INT", settings.position_rate),
        ("SYSTEM_TIME", settings.system_time_rate),
    )
    return [
        Wish(name, (rate, *_below(rate, name == "HIGHRES_IMU")), name == "HIGHRES_IMU")
        for name, rate in wanted
        if rate > 0.0
    ]


def _below(rate: float, is_imu: bool) -> Iterator[float]:
    return (r for r in LADDER if r < rate and not (is_imu and r < SLOWEST_IMU))


def fix_for(autopilot: int, wish: Wish, denied: bool = False) -> str:
    """What makes an autopilot send a message: its parameters, and the line's speed."""
    rate = f"{wish.rates[0]:.0f}"
    if autopilot == ARDUPILOT:
        fix = f"set {_ARDUPILOT_STREAMS.get(wish.name, 'SRx_RAW_SENS')}"
        if wish.is_imu:
            fix = f"raise SCHED_LOOP_RATE to {rate} or more, or {fix}"
    elif autopilot == PX4:
        fix = f"set MAV_x_MODE to Onboard and raise MAV_x_RATE, or 'mavlink stream -s {wish.name} -r {rate}'"
    else:
        fix = f"set the autopilot's rate of {wish.name}"
    if denied:
        return fix
    if wish.is_gnss:
        fix += ", or the receiver has no more"
    bytes_per_second = (fields_of(wish.name).min_length + 12) * wish.rates[0]
    if bytes_per_second < _HEAVY:
        return fix
    baud = next((b for b in _BAUD_RATES if b >= 10.0 * bytes_per_second), _BAUD_RATES[-1])
    return (
        f"{fix}; {wish.name} at {rate} Hz takes {bytes_per_second / 1e3:.1f} kB/s: "
        f"{baud} baud or more"
    )
