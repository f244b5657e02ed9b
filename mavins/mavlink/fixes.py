"""One vehicle's GNSS fixes and headings: from the messages that the sources name, once per stamp, on the time base."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, ClassVar, Final, Protocol

from mavins.estimator.feed import Feed
from mavins.estimator.spacing import shortest_us
from mavins.mavlink.clock import Clock, is_unix
from mavins.mavlink.codec import Attitude, GlobalPosition, GpsInput, GpsRaw, HilGps, fields_of
from mavins.mavlink.sources import Sources
from mavins.types import GnssFix, HeadingFix

PAIR_US: Final = 1_500_000
"""GPS_RAW_INT lends GLOBAL_POSITION_INT its fix type and accuracies up to this age."""
VERTICAL_US: Final = 250_000
REMEMBERED: Final = 50
"""So many stamps of fixes and headings are kept to know a repeated one by."""
ATTITUDE_ID: Final = fields_of("ATTITUDE").msgid
_RECEIVER_IDS: Final = frozenset(fields_of(name).msgid for name in ("GPS_RAW_INT", "GPS2_RAW"))
_GLOBAL_POSITION_ID: Final = fields_of("GLOBAL_POSITION_INT").msgid
_NEVER_USED: Final = frozenset((fields_of("LOCAL_POSITION_NED").msgid,))
"""Only looked at, by the monitor."""


class Stamped(Protocol):
    """A message with a stamp."""

    kind: ClassVar[str]
    wraps: ClassVar[bool]

    @property
    def stamp_us(self) -> int:
        """The stamp as sent."""


class Fixes:
    """Makes fixes and headings and feeds them to an estimator. Until `sources` is known, nothing is used."""

    def __init__(self, feed: Feed, clock: Clock, dropped: Counter[str]) -> None:
        self.last: GnssFix | None = None
        self.handlers: dict[str, Callable[[Any, int], None]] = {
            "GPS_RAW_INT": self._gps_raw,
            "GPS2_RAW": self._gps_raw,
            "GLOBAL_POSITION_INT": self._global_position,
            "GPS_INPUT": self._gps_input,
            "HIL_GPS": self._hil_gps,
            "ATTITUDE": self._attitude,
        }
        self._feed = feed
        self._clock = clock
        self._dropped = dropped
        self._sources: Sources | None = None
        self._idle: frozenset[int] = _NEVER_USED
        self._heading_gap_us = 0.0
        self._quality: GpsRaw | None = None
        self._quality_us = 0
        self._vertical: tuple[int, float] | None = None
        self._fix_stamps: deque[int] = deque(maxlen=REMEMBERED)
        self._heading_stamps: deque[int] = deque(maxlen=REMEMBERED)
        self._heading_stamp: int | None = None

    @property
    def sources(self) -> Sources | None:
        """Which messages are used."""
        return self._sources

    @sources.setter
    def sources(self, sources: Sources) -> None:
        self._sources = sources
        rate = sources.heading_rate
        self._heading_gap_us = 0.0 if rate is None else shortest_us(rate)
        idle = {*_NEVER_USED, *(_RECEIVER_IDS - {fields_of(sources.receiver).msgid})}
        if sources.heading != "attitude":
            idle.add(ATTITUDE_ID)
        if sources.gnss != "global_position_int" and not sources.vertical_velocity:
            idle.add(_GLOBAL_POSITION_ID)
        self._idle = frozenset(idle)

    def is_idle(self, msgid: int, stamp_us: int) -> bool:
        """True for a packet that will change nothing, told at a glance: most ATTITUDEs and GLOBAL_POSITION_INTs."""
        return msgid in self._idle or (msgid == ATTITUDE_ID and self._too_soon(stamp_us))

    @property
    def uses_attitude(self) -> bool:
        """True where ATTITUDE is used, for its heading."""
        return self._sources is not None and self._sources.heading == "attitude"

    def along(
        self, headings: Iterable[tuple[int, int, int, float]]
    ) -> Iterator[tuple[int, HeadingFix]]:
        """The headings to be used of ATTITUDEs that came between IMU samples which are on the time base already.

        Of each: how many of the samples came before it, the newest time then, its stamp and its yaw.
        """
        for rows, newest_us, stamp_us, yaw in headings:
            if not self._too_soon(stamp_us):
                fix = self._heading(Attitude, stamp_us, yaw, None, "attitude", 0, newest_us)
                if fix is not None:
                    yield rows, fix

    def forget(self) -> None:
        """A reboot voids every stamp that was kept."""
        self._quality = None
        self._vertical = None
        self._fix_stamps.clear()
        self._heading_stamps.clear()
        self._heading_stamp = None

    def _too_soon(self, stamp_us: int) -> bool:
        """True for a heading that follows the last one sooner than the sources allow."""
        last = self._heading_stamp
        return last is not None and abs(stamp_us - last) < self._heading_gap_us

    def _time_of(self, message: Stamped, received_us: int) -> int | None:
        """The message's stamp on the time base, or None (counted) where it has none."""
        t_us = self._clock.map(message.stamp_us, received_us, message.wraps)
        if isinstance(t_us, str):
            self._dropped[f"{message.kind} {t_us}"] += 1
            return None
        return t_us

    def _gps_raw(self, message: GpsRaw, received_us: int) -> None:
        sources = self._sources
        if sources is None:
            self._dropped[f"{message.kind} before HEARTBEAT"] += 1
            return
        if sources.heading == "gps_yaw" and message.yaw is not None and message.fix_type >= 3:
            self._use_heading(message, message.yaw, message.hdg_acc, "gps_yaw", received_us)
        self._quality = message
        self._quality_us = received_us
        if sources.gnss not in ("gps_raw_int", "gps2_raw"):
            return
        v_l = None
        if message.speed is not None and message.course is not None:
            v_l = (
                message.speed * math.cos(message.course),
                message.speed * math.sin(message.course),
                math.nan,
            )
            vertical = self._vertical
            if sources.vertical_velocity and vertical is not None:
                fresh = abs(received_us - vertical[0]) <= VERTICAL_US
                v_l = (v_l[0], v_l[1], vertical[1] if fresh else math.nan)
        self._use_fix(message, message.alt, v_l, message, received_us)

    def _global_position(self, message: GlobalPosition, received_us: int) -> None:
        sources = self._sources
        self._vertical = (received_us, message.v_l[2])
        if sources is None or sources.gnss != "global_position_int":
            return
        quality = self._quality
        if quality is None or received_us - self._quality_us > PAIR_US:
            self._dropped["GLOBAL_POSITION_INT without GPS_RAW_INT"] += 1
            return
        v_l = message.v_l if sources.vertical_velocity else (*message.v_l[:2], math.nan)
        self._use_fix(message, message.alt, v_l, quality, received_us)

    def _gps_input(self, message: GpsInput, received_us: int) -> None:
        if self._sources is None or self._sources.gnss != "gps_input" or message.alt is None:
            return
        self._use_fix(message, message.alt, message.v_l, message, received_us)

    def _hil_gps(self, message: HilGps, received_us: int) -> None:
        if self._sources is None or self._sources.gnss != "hil_gps":
            return
        self._use_fix(message, message.alt, message.v_l, message, received_us)

    def _attitude(self, message: Attitude, received_us: int) -> None:
        if self._sources is not None and self._sources.heading == "attitude":
            self._use_heading(message, message.yaw, None, "attitude", received_us)

    def _use_fix(
        self,
        message: GpsRaw | GlobalPosition | GpsInput | HilGps,
        alt: float,
        v_l: tuple[float, float, float] | None,
        quality: GpsRaw | GpsInput | HilGps,
        received_us: int,
    ) -> None:
        """Hand a fix over, once per stamp; `quality` is the message that says how good it is."""
        assert self._sources is not None
        if message.stamp_us in self._fix_stamps:
            self._dropped[f"{message.kind} repeated stamp"] += 1
            return
        t_us = self._time_of(message, received_us)
        if t_us is None:
            return
        self._fix_stamps.append(message.stamp_us)
        # HIL_GPS tells no accuracies
        accuracy = None if isinstance(quality, HilGps) else quality
        utc = is_unix(message.stamp_us) and not is_unix(self._clock.newest_us or 0)
        fix = GnssFix(
            t_us=t_us,
            lat=message.lat,
            lon=message.lon,
            alt=alt,
            v_l=v_l,
            fix_type=quality.fix_type,
            satellites=quality.satellites,
            sigma_h=None if accuracy is None else accuracy.h_acc,
            sigma_v=None if accuracy is None else accuracy.v_acc,
            sigma_speed=None if accuracy is None else accuracy.vel_acc,
            source=message.kind,
            delay=self._sources.utc_delay if utc else self._sources.gnss_delay,
        )
        self.last = fix
        self._feed.feed_gnss(fix)

    def _use_heading(
        self,
        message: GpsRaw | Attitude,
        yaw: float,
        sigma: float | None,
        source: str,
        received_us: int,
    ) -> None:
        """Hand a heading over, no oftener than the sources allow."""
        fix = self._heading(type(message), message.stamp_us, yaw, sigma, source, received_us, None)
        if fix is not None:
            self._feed.feed_heading(fix)

    def _heading(
        self,
        kind: type[GpsRaw | Attitude],
        stamp_us: int,
        yaw: float,
        sigma: float | None,
        source: str,
        received_us: int,
        newest_us: int | None,
    ) -> HeadingFix | None:
        """A heading, unless it came before, comes too soon, or has no time (counted)."""
        assert self._sources is not None
        if stamp_us in self._heading_stamps:
            self._dropped[f"{kind.kind} repeated stamp"] += 1
            return None
        if self._too_soon(stamp_us):
            return None
        t_us = self._clock.map(stamp_us, received_us, kind.wraps, newest_us)
        if isinstance(t_us, str):
            self._dropped[f"{kind.kind} {t_us}"] += 1
            return None
        self._heading_stamp = stamp_us
        self._heading_stamps.append(stamp_us)
        return HeadingFix(t_us, yaw, sigma, source, self._sources.heading_delay)
