"""The vehicle's MAVLink: measurements and truth as the packets that an autopilot would send.

HEARTBEAT and SYSTEM_TIME go out each second; HIGHRES_IMU, ATTITUDE (yaw is the magnetometer's
heading), GPS_RAW_INT with GLOBAL_POSITION_INT of the same time (the receiver's position and NED
velocity) and HIL_STATE_QUATERNION (the truth, for evaluation only) at their sensors' rates.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from mavins.mavlink.codec import encode
from mavins.types import GnssFix, HeadingFix, ImuSample
from sitl.simulation import START_US, Event, Measurements, Simulation, stamp

UNIX_AT_BOOT_US: Final = 1_767_225_600_000_000
"""The simulated world's clock at boot: 2026-01-01 00:00 UTC."""
MAV_TYPE_QUADROTOR: Final = 2
MAV_AUTOPILOT_GENERIC: Final = 0
NO_RATES: Final = (0.0, 0.0, 0.0)

Output = Callable[[int, bytes], None]
"""Takes a packet and its time in us since boot."""

# an unpaced stream pauses this long after so many packets, so that a receiver can drain its socket
BREATH: Final = 0.001
BREATH_AFTER: Final = 64
# the longest sleep, after which a wish to stop is noticed
NAP: Final = 0.1


class Emitter:
    """Packets of one vehicle, numbered one after the other."""

    def __init__(self, home_alt: float, sysid: int = 1, compid: int = 1) -> None:
        self._home_alt = home_alt
        self._sysid = sysid
        self._compid = compid
        self._seq = 0

    def packets(self, block: Measurements) -> Iterator[tuple[int, bytes]]:
        """The packets (t_us, bytes) of one second of measurements."""
        begin = int(block.imu.t_us[0])
        yield begin, self._frame(encode.heartbeat(MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_GENERIC))
        yield begin, self._frame(encode.system_time(UNIX_AT_BOOT_US + begin, begin))
        for event in block.events():
            for payload in self._payloads(event):
                yield stamp(event), self._frame(payload)

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

    def _frame(self, payload: encode.Payload) -> bytes:
        packet = encode.frame(payload, self._sysid, self._compid, self._seq)
        self._seq = (self._seq + 1) & 0xFF
        return packet


def packets(simulation: Simulation, sysid: int = 1, compid: int = 1) -> Iterator[tuple[int, bytes]]:
    """All packets (t_us, bytes) of a simulation, without end."""
    emitter = Emitter(simulation.scenario.origin.alt, sysid, compid)
    for block in simulation.blocks():
        yield from emitter.packets(block)


def fly(
    stream: Iterator[tuple[int, bytes]],
    output: Output,
    duration: float = math.inf,
    speed: float = 1.0,
    stopped: Callable[[], bool] = lambda: False,
    breathe: bool = True,
) -> None:
    """Give the stream's first `duration` s to `output` at `speed` times real time until `stopped`.

    An infinite speed does not wait; with `breathe` it pauses now and then for a receiver that must
    keep up.
    """
    begin = time.monotonic()
    end_us = START_US + duration * 1e6
    for count, (t_us, packet) in enumerate(stream, start=1):
        if t_us >= end_us:
            return
        due = begin + (t_us - START_US) / 1e6 / speed
        while not stopped() and (delay := due - time.monotonic()) > 0.0:
            time.sleep(min(delay, NAP))
        if stopped():
            return
        output(t_us, packet)
        if breathe and speed == math.inf and count % BREATH_AFTER == 0:
            time.sleep(BREATH)
