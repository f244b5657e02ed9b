"""One time base per vehicle: every stamp it sends -> integer microseconds on the clock of its IMU
stamps.

Stamps come in three kinds: boot microseconds, boot milliseconds (they start again from zero after
2^32 ms) and microseconds since 1970, told by their magnitude. The IMU's own kind is the base. A
stamp of the other kind is carried over with the offset that SYSTEM_TIME tells; until one was seen,
its message is placed by when it was received: t = received - lag, where lag is the smallest
reception-minus-stamp of the IMU of the last one to two seconds (so a link or simulation that falls
behind does not pull old offsets in).

A stamp is believed at once while it stays close to the newest one. Farther away it must be
confirmed by two more that agree with it: then it was a reboot (backward) or a jump or outage
(forward), before it is dropped as wild.

Everything depends on message content and the recorded reception stamp only, row by row, so that
live and replay map alike however rows are grouped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavins.mavlink.codec.decode import FIRST_UNIX_US
from mavins.nav.kernels import kernel
from mavins.types import IntArray

WRAP_US: Final = 2**32 * 1000
"""Where boot milliseconds start again, in microseconds (49.7 days)."""
MAX_BACKWARD_US: Final = 1_000_000
"""An IMU stamp older than the newest by more is a reboot, once confirmed; by less it is a reordered
packet.
"""
MAX_FORWARD_US: Final = 500_000
"""An IMU stamp newer than the newest by more must be confirmed."""
MAX_APART_US: Final = 10_000_000
"""Any other message's stamp lies within this of the newest IMU stamp, or it is wild."""
CONFIRMATIONS: Final = 3
"""So many consecutive stamps must agree before a jump or reboot is believed."""
_BUCKET_US: Final = 1_000_000

NEWEST, STARTED, PENDING, AGREEING, WRAPPED, LAG, LAG_BEFORE, BUCKET = range(8)
_KEEP: Final = 0
_ZERO: Final = 1
_WILD: Final = 2
_REBOOT: Final = 3
_JUMP: Final = 4

EventKind: TypeAlias = Literal["reboot", "jump"]
Rejection: TypeAlias = Literal["zero stamp", "wild stamp", "no IMU yet"]


def is_unix(stamp_us: int) -> bool:
    """True for a stamp that counts from 1970, False for one that counts from boot."""
    return stamp_us > FIRST_UNIX_US


@dataclass(frozen=True, slots=True)
class ClockEvent:
    """The IMU's clock went on elsewhere at row `row`: from `before_us` to `t_us`.

    A `reboot` goes backward, all earlier times are void; a `jump` goes forward, by an outage or by
    a set clock.
    """

    kind: EventKind
    row: int
    before_us: int
    t_us: int


@dataclass(frozen=True, slots=True)
class ImuTimes:
    """The times of N IMU rows: `t_us` (N,) where `keep` (N,) is True, events in order, and what was
    dropped.
    """

    t_us: IntArray
    keep: NDArray[np.bool_]
    events: tuple[ClockEvent, ...]
    zero_stamps: int
    wild_stamps: int

    @property
    def regular(self) -> bool:
        """True where every row is kept and nothing happened between them."""
        return not (self.events or self.zero_stamps or self.wild_stamps)


class Clock:
    """The clock of one vehicle. Feed it each IMU row and SYSTEM_TIME; ask it for the time of
    everything else.
    """

    def __init__(self) -> None:
        self._state: IntArray = np.zeros(8, np.int64)
        self._unix_minus_boot: int | None = None

    @property
    def newest_us(self) -> int | None:
        """The newest IMU time, or None before the first."""
        return int(self._state[NEWEST]) if self._state[STARTED] else None

    @property
    def unix_minus_boot_us(self) -> int | None:
        """UNIX minus boot time by SYSTEM_TIME, or None while not known."""
        return self._unix_minus_boot

    def map_imu(self, stamp_us: IntArray, received_us: IntArray, wraps: bool = False) -> ImuTimes:
        """The times of N consecutive IMU rows of the one chosen message and id.

        `stamp_us` (N,) as sent, `received_us` (N,) microseconds of our clock; `wraps` for boot
        milliseconds.
        """
        t_us, verdict, before = np.empty((3, len(stamp_us)), np.int64)
        regular = _map_rows(self._state, stamp_us, received_us, wraps, t_us, verdict, before)
        if regular:
            return ImuTimes(t_us, verdict == _KEEP, (), 0, 0)
        events = []
        for row in np.flatnonzero(verdict > _WILD).tolist():
            kind: EventKind = "reboot" if verdict[row] == _REBOOT else "jump"
            events.append(ClockEvent(kind, row, int(before[row]), int(t_us[row])))
            if kind == "reboot":
                self._unix_minus_boot = None
        keep = (verdict != _ZERO) & (verdict != _WILD)
        zeros, wild = int((verdict == _ZERO).sum()), int((verdict == _WILD).sum())
        return ImuTimes(t_us, keep, tuple(events), zeros, wild)

    def knows(self, stamp_us: int) -> bool:
        """True where a stamp like this one has its time from itself, and not from when it is received."""
        newest = self.newest_us
        if newest is None:
            return False
        return is_unix(stamp_us) == is_unix(newest) or self._unix_minus_boot is not None

    def state(self) -> IntArray:
        """What `map_imu` changes where nothing happens between its rows, for `set_back`."""
        return self._state.copy()

    def set_back(self, state: IntArray) -> None:
        """Forget the IMU rows since then."""
        self._state = state

    def system_time(self, unix_us: int | None, boot_us: int) -> None:
        """Learn the offset of the two clocks from a SYSTEM_TIME; one without UNIX time says
        nothing.
        """
        newest = self.newest_us
        if unix_us is None or newest is None:
            return
        if is_unix(newest):
            seen_us = unix_us
        else:
            seen_us = boot_us = _unwrapped(boot_us, newest)
        if abs(seen_us - newest) <= MAX_APART_US:
            self._unix_minus_boot = unix_us - boot_us

    @property
    def lag_us(self) -> int:
        """Our clock minus the vehicle's: the smallest reception minus stamp of the IMU of late; 0 before the first."""
        return min(int(self._state[LAG]), int(self._state[LAG_BEFORE]))

    def unix_of(self, t_us: int) -> int | None:
        """Microseconds since 1970 at a time on this clock, or None while the vehicle has not told."""
        if is_unix(t_us):
            return t_us
        return None if self._unix_minus_boot is None else t_us + self._unix_minus_boot

    def map(
        self, stamp_us: int, received_us: int, wraps: bool = False, newest: int | None = None
    ) -> int | Rejection:
        """The time of a message that is not an IMU's, or why it has none; arguments as for
        `map_imu`. `newest` is the newest IMU time where that is an older one.
        """
        if newest is None:
            newest = self.newest_us
        if newest is None:
            return "no IMU yet"
        if stamp_us <= 0:
            return "zero stamp"
        offset = self._unix_minus_boot
        if is_unix(stamp_us) == is_unix(newest):
            t_us = _unwrapped(stamp_us, newest) if wraps else stamp_us
        elif offset is None:
            t_us = received_us - self.lag_us
        elif is_unix(stamp_us):
            t_us = stamp_us - offset
        else:
            t_us = (_unwrapped(stamp_us, newest - offset) if wraps else stamp_us) + offset
        return t_us if abs(t_us - newest) <= MAX_APART_US else "wild stamp"


def _unwrapped(stamp_us: int, near_us: int) -> int:
    """The stamp plus that many wraps which bring it nearest to `near_us`."""
    return stamp_us + (near_us - stamp_us + WRAP_US // 2) // WRAP_US * WRAP_US


@kernel
def _map_rows(
    state: IntArray,
    stamp_us: IntArray,
    received_us: IntArray,
    wraps: bool,
    t_us: IntArray,
    verdict: IntArray,
    before: IntArray,
) -> bool:
    """Walk IMU rows through the clock's `state`; fill the three last arguments; the number of rows
    dropped.
    """
    regular = True
    for i in range(stamp_us.size):
        newest = state[NEWEST]
        before[i] = newest
        t = stamp_us[i]
        t_us[i] = t
        if t <= 0:
            # with milliseconds that wrap, zero is also the stamp of one true instant in 49.7 days
            verdict[i] = _ZERO
            regular = False
            continue
        if wraps and state[STARTED]:
            near = t + (newest - t + WRAP_US // 2) // WRAP_US * WRAP_US
            continuous = newest - MAX_BACKWARD_US <= near <= newest + MAX_FORWARD_US
            t = near if continuous else t + state[WRAPPED]
        verdict[i] = _KEEP
        if state[STARTED] == 0:
            state[STARTED] = 1
            state[BUCKET] = -2
            newest = t
        elif t < newest - MAX_BACKWARD_US or t > newest + MAX_FORWARD_US:
            # a stamp that was already seen neither confirms nor denies
            if state[AGREEING] > 0 and abs(t - state[PENDING]) <= MAX_FORWARD_US:
                state[AGREEING] += t != state[PENDING]
            else:
                state[AGREEING] = 1
            state[PENDING] = t
            if state[AGREEING] < CONFIRMATIONS:
                verdict[i] = _WILD
                regular = False
                continue
            regular = False
            verdict[i] = _REBOOT if t < newest else _JUMP
            if t < newest:
                t = stamp_us[i]  # a new boot has not wrapped yet
            newest = t
            state[BUCKET] = -2
        state[AGREEING] = 0
        t_us[i] = t
        if t >= newest:
            state[NEWEST] = t
            if wraps:
                state[WRAPPED] = t - stamp_us[i]
            lag = received_us[i] - t
            bucket = t // _BUCKET_US
            if bucket == state[BUCKET]:
                state[LAG] = min(state[LAG], lag)
            else:
                state[LAG_BEFORE] = state[LAG] if bucket == state[BUCKET] + 1 else lag
                state[LAG] = lag
                state[BUCKET] = bucket
    return regular
