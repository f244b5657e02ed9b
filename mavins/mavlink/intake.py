"""One vehicle's messages on their way into its estimator: chooses sources, maps clocks.

Live and replay both come through `Intake.take`: live with the packets of one datagram, replay with those of a whole
log. Neighbouring IMU packets go on as one table; the outcome does not depend on how they were grouped.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Final, Protocol, TypeAlias

import numpy as np

from mavins.estimator.feed import Between, Feed
from mavins.estimator.settings import Settings
from mavins.estimator.spacing import shortest_us
from mavins.mavlink.clock import NEWEST, Clock, ImuTimes
from mavins.mavlink.codec import (
    IMU_KINDS,
    Attitude,
    Frames,
    GlobalPosition,
    Heartbeat,
    Invalid,
    LocalPosition,
    SystemTime,
    decode,
    decode_yaws,
    fields_of,
    name_of,
)
from mavins.mavlink.codec.framing import gather
from mavins.mavlink.fixes import ATTITUDE_ID, Fixes
from mavins.mavlink.imu_source import IMU_IDS, ImuSource, Samples
from mavins.mavlink.sources import Sources, SourceSettings, resolve
from mavins.types import FloatArray, GnssFix, ImuTable, IntArray, MagSample

HEARTBEAT_WAIT_US: Final = 3_000_000
"""A vehicle without a HEARTBEAT for this long is taken for one that sends raw sensors."""
_OTHER_IDS: Final = np.array(
    sorted(
        fields_of(name).msgid
        for name in (
            "HEARTBEAT",
            "SYSTEM_TIME",
            "GPS_RAW_INT",
            "GPS2_RAW",
            "GLOBAL_POSITION_INT",
            "GPS_INPUT",
            "HIL_GPS",
            "ATTITUDE",
            "LOCAL_POSITION_NED",
        )
    ),
    dtype=np.int64,
)
RELEVANT: Final = np.union1d(IMU_IDS, _OTHER_IDS)
"""The message ids that an intake looks at; all others may be left out."""
Waiting: TypeAlias = tuple[int, int, int, float]
"""An ATTITUDE: how many IMU samples came before it, which packet it is, its stamp in us and its yaw in rad."""
_FROM_ANY_COMPONENT: Final = ("GPS_INPUT", "HIL_GPS")
_MAV_AUTOPILOT_INVALID: Final = 8


def _boot_stamps(frames: Frames, at: IntArray) -> list[int]:
    """The first four payload bytes of packets `at` as boot milliseconds, in microseconds: right for the messages
    that begin so, of no meaning for others."""
    table = np.ascontiguousarray(frames.table[2:4, at])
    head = gather(frames.data, table[0], table[1], 4)
    stamps: list[int] = (head.view("<u4")[:, 0].astype(np.int64) * 1000).tolist()
    return stamps


class Watcher(Protocol):
    """Who looks at what an autopilot says of itself; it changes no estimate."""

    def wants(self, msgid: int, stamp_us: int, autopilot: int | None) -> bool:
        """True for a packet that is to be shown."""

    def see(self, msgid: int, message: Any, t_us: int) -> None:
        """Look at a message, whose stamp is `t_us` on the vehicle's time base."""

    def summary(self) -> dict[str, Any] | None:
        """What was seen in all, for the summary of a run."""


class Intake:
    """Feeds one vehicle's estimator from its packets."""

    def __init__(
        self, estimator: Feed, settings: SourceSettings, watcher: Watcher | None = None
    ) -> None:
        self.estimator = estimator
        self.watcher = watcher
        self.clock = Clock()
        self.counts: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.imu = ImuSource(self.dropped, estimator.settings.magnetometer.enabled is True)
        self.fixes = Fixes(estimator, self.clock, self.dropped)
        self.autopilot: int | None = None
        self.reboots = 0
        self._settings = settings
        self._tuning = estimator.settings
        self._field_us: int | None = None
        self._handlers: dict[str, Callable[[Any, int], None]] = {
            "HEARTBEAT": self._heartbeat,
            "SYSTEM_TIME": self._system_time,
            **self.fixes.handlers,
        }

    def reconfigure(self, settings: Settings, filter_name: str, sources: SourceSettings) -> None:
        """Go on with other settings, filter and sources."""
        self.estimator.reconfigure(settings, filter_name)
        self._settings, self._tuning = sources, settings
        if self.autopilot is not None:
            self._resolve(self.autopilot)

    @property
    def sources(self) -> Sources | None:
        """The messages that are used, once that is known."""
        return self.fixes.sources

    @property
    def last_fix(self) -> GnssFix | None:
        """The newest fix that went to the estimator."""
        return self.fixes.last

    def take(self, frames: Frames) -> None:
        """Take packets of this vehicle, in their order, each with its reception stamp in `frames.t_us`.

        IMU packets are put off until something comes whose place among them matters, and then go on together.
        """
        if len(frames) == 1:
            self._take_one(frames)
            return
        for msgid, n in zip(*np.unique(frames.msgid, return_counts=True), strict=True):
            self.counts[name_of(int(msgid))] += int(n)
        if self.imu.chosen is None:
            frames = self._until_chosen(frames)
        if not len(frames):
            return
        is_imu = np.isin(frames.msgid, IMU_IDS)
        samples = self.imu.samples(frames, np.flatnonzero(is_imu))
        others = np.flatnonzero(~is_imu)
        stamps = _boot_stamps(frames, others)
        msgids, places = frames.msgid[others].tolist(), np.searchsorted(samples.at, others).tolist()
        is_idle, taken = self.fixes.is_idle, 0
        waiting: list[Waiting] = []
        rows = zip(others.tolist(), msgids, stamps, places, self._yaws(frames, others), strict=True)
        for i, msgid, stamp_us, before, yaw in rows:
            idle, watched = is_idle(msgid, stamp_us), self._is_watched(msgid, stamp_us)
            heads = msgid == ATTITUDE_ID and not watched and self.fixes.uses_attitude
            # behind one that waits, whether another comes too soon is known only when that is used
            if idle and not watched and not (heads and waiting):
                continue
            if heads:
                waiting.append((before, i, stamp_us, yaw))
                continue
            if before > taken or waiting:
                self._place_with(frames, samples, slice(taken, before), waiting)
                taken, waiting = before, []
            if watched:
                self._show(frames, i)
            if not idle:
                self._take_other(frames, i)
        self._place_with(frames, samples, slice(taken, len(samples.at)), waiting)

    def _take_one(self, frames: Frames) -> None:
        """Take one packet: what `take` comes to for the usual datagram, without the tables."""
        msgid = int(frames.msgid[0])
        self.counts[name_of(msgid)] += 1
        if msgid not in IMU_KINDS:
            stamp_us = int.from_bytes(frames.body(0, 4), "little") * 1000
            if self._is_watched(msgid, stamp_us):
                self._show(frames, 0)
            if not self.fixes.is_idle(msgid, stamp_us):
                self._take_other(frames, 0)
        elif self.imu.chosen is not None or self.imu.offer(frames, 0):
            sample = self.imu.sample(frames, 0)
            if sample is not None:
                self._place(sample, slice(0, 1))

    def rates(self) -> dict[str, float]:
        """Messages per second of the time from the first to the newest IMU sample, by reception."""
        first_us, newest_us = self.imu.first_us, self.imu.newest_us
        if first_us is None or newest_us <= first_us:
            return {}
        seconds = (newest_us - first_us) * 1e-6
        return {name: n / seconds for name, n in self.counts.items()}

    def _is_watched(self, msgid: int, stamp_us: int) -> bool:
        """True for a packet that the watcher wants to see."""
        return self.watcher is not None and self.watcher.wants(msgid, stamp_us, self.autopilot)

    def _show(self, frames: Frames, i: int) -> None:
        """Let the watcher see a message of the vehicle's autopilot, where it has a time; nothing is counted."""
        if int(frames.compid[i]) != self.imu.compid:
            return
        message = decode(frames, i)
        if isinstance(message, Attitude | GlobalPosition | LocalPosition):
            assert self.watcher is not None
            t_us = self.clock.map(message.stamp_us, int(frames.t_us[i]), message.wraps)
            if isinstance(t_us, int):
                self.watcher.see(int(frames.msgid[i]), message, t_us)

    # ---- IMU ---------------------------------------------------------------------------------------------------

    def _until_chosen(self, frames: Frames) -> Frames:
        """Take packets one by one until the IMU message is chosen; returns those from the chosen one on."""
        for i in range(len(frames)):
            if int(frames.msgid[i]) not in IMU_KINDS:
                self._take_other(frames, i)
                continue
            if self.imu.offer(frames, i):
                return frames.select(np.arange(i, len(frames)))
        return frames.select(np.arange(0))

    def _yaws(self, frames: Frames, at: IntArray) -> list[float]:
        """The yaws (rad) of packets `at` that are ATTITUDEs of the vehicle, and nan for all others."""
        yaws = np.full(len(at), np.nan)
        rows = np.flatnonzero(
            (frames.msgid[at] == ATTITUDE_ID) & (frames.compid[at] == self.imu.compid)
        )
        if len(rows):
            yaws[rows] = decode_yaws(frames, at[rows])
        known: list[float] = yaws.tolist()
        return known

    def _place_with(
        self, frames: Frames, samples: Samples, part: slice, waiting: Sequence[Waiting]
    ) -> None:
        """Hand samples over, and with them the headings of the ATTITUDEs that came between them."""
        if not (waiting and self._place_together(samples, part, waiting)):
            self._place_by_turns(frames, samples, part, waiting)

    def _place_together(self, samples: Samples, part: slice, waiting: Sequence[Waiting]) -> bool:
        """The same in one go; False, and nothing done, where something happens on the way that has to be seen to."""
        start = part.start
        if part.stop == start or not self.clock.knows(waiting[0][2]):
            return False
        if any(math.isnan(yaw) for _, _, _, yaw in waiting):
            return False
        state = self.clock.state()
        stamp_us, received_us = samples.stamp_us[part], samples.received_us[part]
        times = self.clock.map_imu(stamp_us, received_us, self.imu.wraps)
        if not times.regular:
            self.clock.set_back(state)
            return False
        newest = np.maximum.accumulate(np.append(state[NEWEST], times.t_us)).tolist()
        headings = (
            (before - start, newest[before - start], stamp_us, yaw)
            for before, _, stamp_us, yaw in waiting
        )
        self._feed(*samples.table(times.t_us, part), list(self.fixes.along(headings)))
        return True

    def _place_by_turns(
        self, frames: Frames, samples: Samples, part: slice, waiting: Sequence[Waiting]
    ) -> None:
        """The same one after the other."""
        taken = part.start
        for before, i, stamp_us, _ in waiting:
            if before > taken:
                self._place(samples, slice(taken, before))
                taken = before
            if not self.fixes.is_idle(ATTITUDE_ID, stamp_us):
                self._take_other(frames, i)
        if part.stop > taken:
            self._place(samples, slice(taken, part.stop))

    def _place(self, samples: Samples, part: slice) -> None:
        """Put samples on the time base and hand them over; a reboot between them starts the estimator over."""
        received_us = samples.received_us[part]
        times = self.clock.map_imu(samples.stamp_us[part], received_us, self.imu.wraps)
        table, field = samples.table(times.t_us, part)
        if times.regular:
            self._feed(table, field)
        else:
            self.dropped["IMU zero stamp"] += times.zero_stamps
            self.dropped["IMU wild stamp"] += times.wild_stamps
            self._place_around_events(times, table, field)
        if self.sources is None and self.imu.first_us is not None:
            waited_us = int(received_us[-1]) - self.imu.first_us
            if waited_us > HEARTBEAT_WAIT_US:
                self._resolve(_MAV_AUTOPILOT_INVALID)

    def _feed(
        self, table: ImuTable, field: FloatArray | None, headings: Sequence[Between] = ()
    ) -> None:
        """Hand samples over, headings between them, and behind each that brings a due magnetometer reading, it."""
        between: list[Between] = []
        for row in [] if field is None else self._due(table.t_us, field):
            assert field is not None
            sample = MagSample(int(table.t_us[row]), field[row], self.imu.name)
            between.append((row + 1, sample))
        if between and headings:
            # of readings at one place the magnetometer's is first, it came with the sample
            headings = sorted([*between, *headings], key=itemgetter(0))
        self.estimator.feed_run(table, headings or between)

    def _due(self, t_us: IntArray, field: FloatArray) -> list[int]:
        """The rows whose reading follows the last one no sooner than the settings allow."""
        interval = shortest_us(self._tuning.magnetometer.max_rate)
        due = []
        for row in np.flatnonzero(np.isfinite(field[:, 0])).tolist():
            stamp_us = int(t_us[row])
            if self._field_us is None or abs(stamp_us - self._field_us) >= interval:
                self._field_us = stamp_us
                due.append(row)
        return due

    def _place_around_events(
        self, times: ImuTimes, table: ImuTable, field: FloatArray | None
    ) -> None:
        start = 0
        reboots = [event.row for event in times.events if event.kind == "reboot"]
        for end in (*reboots, len(times.t_us)):
            rows = start + np.flatnonzero(times.keep[start:end])
            if len(rows):
                self._feed(table[rows], None if field is None else field[rows])
            if end in reboots:
                self.reboots += 1
                self._forget()
                self.estimator.restart("the vehicle has rebooted")
            start = end

    def _forget(self) -> None:
        """A reboot voids every stamp that was kept."""
        self.fixes.forget()
        self._field_us = None

    # ---- everything else ---------------------------------------------------------------------------------------

    def _take_other(self, frames: Frames, i: int) -> None:
        message = decode(frames, i)
        if message is None:
            return
        if isinstance(message, Invalid):
            self.dropped[f"{message.kind} {message.reason}"] += 1
            return
        handler = self._handlers.get(message.kind)
        from_vehicle = int(frames.compid[i]) == self.imu.compid
        if handler is None or not (from_vehicle or message.kind in _FROM_ANY_COMPONENT):
            return
        handler(message, int(frames.t_us[i]))

    def _resolve(self, autopilot: int) -> None:
        self.autopilot = autopilot
        tuning = self._tuning
        self.fixes.sources = resolve(self._settings, tuning.gnss, tuning.heading, autopilot)

    def _heartbeat(self, message: Heartbeat, received_us: int) -> None:
        if self.autopilot != message.autopilot:
            self._resolve(message.autopilot)

    def _system_time(self, message: SystemTime, received_us: int) -> None:
        self.clock.system_time(message.unix_us, message.boot_us)
