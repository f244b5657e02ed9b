"""How an autopilot's boot clock stands to ours, by TIMESYNC: for people, not for the estimator.

We send ts1 = our time (ns); the answer brings ts1 back with tc1, the autopilot's time. Received at t2,

    round trip = t2 - ts1,    offset = (ts1 + t2) / 2 - tc1

is wrong by half the difference of the two ways, so the shortest of the last eight round trips is believed, as NTP's
clock filter does (RFC 5905, section 10).
"""

from __future__ import annotations

from collections import deque
from typing import Final

from mavins.mavlink.codec import Payload, fields_of, payload

TIMESYNC: Final = fields_of("TIMESYNC")
PERIOD_US: Final = 1_000_000
REMEMBERED: Final = 8
MAX_BACKWARD_NS: Final = 1_000_000_000
"""A clock that goes back by more was started anew."""


class Timesync:
    """The time of one autopilot."""

    def __init__(self) -> None:
        self._sent_ns: int | None = None
        self._newest_ns: int | None = None
        self._next_us: int | None = None
        self._samples: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)

    @property
    def round_trip(self) -> float | None:
        """The shortest of the last round trips in s, or None while there was no answer."""
        return min(self._samples)[0] * 1e-9 if self._samples else None

    @property
    def offset(self) -> float | None:
        """Our time minus the autopilot's in s."""
        return min(self._samples)[1] * 1e-9 if self._samples else None

    def request(self, now_us: int) -> Payload | None:
        """The request that is due, once a second."""
        if self._next_us is not None and now_us < self._next_us:
            return None
        self._next_us = now_us + PERIOD_US
        self._sent_ns = now_us * 1000
        return payload(TIMESYNC, tc1=0, ts1=self._sent_ns)

    def take(self, tc1: int, ts1: int, now_us: int) -> bool:
        """An answer; True where it tells of a reboot. One to somebody else's request says nothing."""
        if tc1 <= 0 or ts1 != self._sent_ns:
            return False
        self._sent_ns = None
        rebooted = self._newest_ns is not None and tc1 < self._newest_ns - MAX_BACKWARD_NS
        if rebooted:
            self._samples.clear()
        self._newest_ns = tc1
        now_ns = now_us * 1000
        self._samples.append((now_ns - ts1, (ts1 + now_ns) // 2 - tc1))
        return rebooted
