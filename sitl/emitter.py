"""The vehicle's MAVLink: measurements and truth as the packets that an autopilot would send.

HEARTBEAT and SYSTEM_TIME go out each second; HIGHRES_IMU, ATTITUDE (yaw is the magnetometer's
heading), GPS_RAW_INT with GLOBAL_POSITION_INT of the same time (the receiver's position and NED
velocity) and HIL_STATE_QUATERNION (the truth, for evaluation only) at their sensors' rates, or as they were asked
for. Nothing that is asked changes what is measured.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeVar

from mavins.mavlink.codec import encode, fields_of
from mavins.types import GnssFix, HeadingFix, ImuSample
from sitl.answers import Answers, Streams
from sitl.scenario import Scenario
from sitl.simulation import BLOCK_US, START_US, Event, Measurements, Simulation, stamp

UNIX_AT_BOOT_US: Final = 1_767_225_600_000_000
"""The simulated world's clock at boot: 2026-01-01 00:00 UTC."""
MAV_TYPE_QUADROTOR: Final = 2
MAV_AUTOPILOT_GENERIC: Final = 0
NO_RATES: Final = (0.0, 0.0, 0.0)

Item = TypeVar("Item")
"""A packet, or what will be one."""

# an unpaced stream pauses this long after so many packets, so that a receiver can drain its socket
BREATH: Final = 0.001
BREATH_AFTER: Final = 64
# the longest sleep, after which a wish to stop is noticed
NAP: Final = 0.1


class Emitter:
    """Packets of one vehicle, numbered one after the other: its streams and its answers."""

    def __init__(self, scenario: Scenario, sysid: int = 1, compid: int = 1) -> None:
        self._home_alt = scenario.origin.alt
        self._streams = Streams(scenario.streams, own_intervals_us(scenario))
        self._answers = Answers(scenario.commands, self._streams, sysid, compid)
        self._sysid = sysid
        self._compid = compid
        self._seq = 0

    def packets(self, block: Measurements) -> Iterator[tuple[int, bytes]]:
        """The packets (t_us, bytes) of one second of measurements."""
        return ((t_us, self.number(payload)) for t_us, payload in self.payloads(block))

    def payloads(self, block: Measurements) -> Iterator[tuple[int, encode.Payload]]:
        """What is in them, not numbered yet: an answer may go out before."""
        begin = int(block.imu.t_us[0])
        clock = encode.system_time(UNIX_AT_BOOT_US + begin, begin)
        for payload in (encode.heartbeat(MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_GENERIC), clock):
            if self._streams.passes(payload.msgid, begin):
                yield begin, payload
        for event in block.events():
            for payload in self._payloads(event):
                if self._streams.passes(payload.msgid, stamp(event)):
                    yield stamp(event), payload

    def answer(self, data: bytes, boot_us: int) -> list[bytes]:
        """The packets that a datagram is answered with."""
        return [self.number(payload) for payload in self._answers.to(data, boot_us)]

    def _payloads(self, event: Event) -> Sequence[encode.Payload]:
        if isinstance(event, ImuSample):
            return (encode.highres_imu(event),)
        if isinstance(event, HeadingFix):
            return (encode.attitude(event.t_us, 0.0, 0.0, event.yaw, NO_RATES),)
        if isinstance(event, GnssFix):
            return encode.gps_raw_int(event), self._position(event)
        return (encode.hil_state_quaternion(event.sample, event.f_b, event.w_b),)

    def _position(self, fix: GnssFix) -> encode.Payload:
        above_home = fix.alt - self._home_alt
        v_l = fix.v_l or (0.0, 0.0, 0.0)
        return encode.global_position_int(
            fix.t_us, fix.lat, fix.lon, fix.alt, above_home, v_l, None
        )

    def number(self, payload: encode.Payload) -> bytes:
        """The next packet."""
        packet = encode.frame(payload, self._sysid, self._compid, self._seq)
        self._seq = (self._seq + 1) & 0xFF
        return packet


def own_intervals_us(scenario: Scenario) -> dict[int, int]:
    """Message id -> the interval of its sensor in us."""
    rates = {
        "HEARTBEAT": 1,
        "SYSTEM_TIME": 1,
        "HIGHRES_IMU": scenario.imu.rate,
        "ATTITUDE": scenario.heading.rate,
        "GPS_RAW_INT": scenario.gnss.rate,
        "GLOBAL_POSITION_INT": scenario.gnss.rate,
        "HIL_STATE_QUATERNION": scenario.truth_rate,
    }
    return {fields_of(name).msgid: BLOCK_US // rate for name, rate in rates.items()}


def packets(
    simulation: Simulation, sysid: int = 1, compid: int = 1, emitter: Emitter | None = None
) -> Iterator[tuple[int, bytes]]:
    """All packets (t_us, bytes) of a simulation, without end."""
    emitter = emitter or Emitter(simulation.scenario, sysid, compid)
    for block in simulation.blocks():
        yield from emitter.packets(block)


def fly(
    stream: Iterator[tuple[int, Item]],
    output: Callable[[int, Item], None],
    duration: float = math.inf,
    speed: float = 1.0,
    stopped: Callable[[], bool] = lambda: False,
    breathe: bool = True,
    wait: Callable[[float], None] = time.sleep,
) -> None:
    """Give the stream's first `duration` s to `output` at `speed` times real time until `stopped`.

    Its items come with their us since boot.

    An infinite speed does not wait; with `breathe` it pauses now and then for a receiver that must
    keep up. `wait` passes up to so many seconds.
    """
    begin = time.monotonic()
    end_us = START_US + duration * 1e6
    for count, (t_us, item) in enumerate(stream, start=1):
        if t_us >= end_us:
            return
        due = begin + (t_us - START_US) / 1e6 / speed
        while not stopped() and (delay := due - time.monotonic()) > 0.0:
            wait(min(delay, NAP))
        if stopped():
            return
        output(t_us, item)
        if breathe and speed == math.inf and count % BREATH_AFTER == 0:
            time.sleep(BREATH)
