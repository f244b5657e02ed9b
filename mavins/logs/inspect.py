"""What a log holds, read off without a filter: messages, rates, gaps, vehicles, truth, damage,
sources.

Rates of messages are by reception, those of the IMU by its own stamps.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.estimator.settings import GnssSettings, HeadingSettings
from mavins.logs.truth import truth_of
from mavins.mavlink.clock import Clock, is_unix
from mavins.mavlink.codec import (
    WRAPPING_IMU_KINDS,
    Damage,
    Frames,
    decode_imu,
    fields_of,
    name_of,
    payload_rows,
)
from mavins.mavlink.imu_source import IMU_IDS, ImuSource
from mavins.mavlink.sources import Sources, SourceSettings, resolve
from mavins.types import IntArray

GAP_FACTOR: Final = 3.0
"""An IMU interval longer than so many median intervals is a gap."""
RECEPTION_JUMP_US: Final = 10_000_000
_MAV_AUTOPILOT_INVALID: Final = 8


@dataclass(frozen=True, slots=True)
class MessageCount:
    """How often one component sent one message, and its mean rate in Hz (0 for a single one)."""

    sysid: int
    compid: int
    name: str
    count: int
    rate: float


@dataclass(frozen=True, slots=True)
class Gap:
    """A hole between two IMU samples: where it begins (us on the IMU's time base) and its length in
    s.
    """

    t_us: int
    length: float


@dataclass(frozen=True, slots=True)
class VehicleReport:
    """One system that sends an IMU.

    `imu` is the message that would be used and `imu_id` its sensor, `imu_rate` Hz by its stamps;
    `t_us` the first and last IMU time; `reboots`, `jumps` and `wild_stamps` are what the clock
    noticed; `gnss_fixes` counts messages of the GNSS source with a 3-D fix; `truth` names the
    message that carries a truth.
    """

    sysid: int
    compid: int
    autopilot: int | None
    vehicle_type: int | None
    imu: str
    imu_id: int
    imu_rate: float
    imu_count: int
    t_us: tuple[int, int]
    gaps: tuple[Gap, ...]
    reboots: int
    jumps: int
    wild_stamps: int
    unusable: int
    sources: Sources
    gnss_fixes: int
    gnss_is_utc: bool
    truth: str | None
    truth_count: int


@dataclass(frozen=True, slots=True)
class LogReport:
    """All of a log: `duration` in s and `received_us` (first, last) by reception stamps."""

    packets: int
    size: int
    duration: float
    received_us: tuple[int, int]
    reception_jumps: int
    damage: Damage
    messages: tuple[MessageCount, ...]
    vehicles: tuple[VehicleReport, ...]


def inspect(frames: Frames) -> LogReport:
    """Look through a log that is not empty."""
    t_us = frames.t_us
    steps = np.diff(t_us)
    return LogReport(
        packets=len(frames),
        size=frames.data.size,
        duration=float(t_us.max() - t_us.min()) * 1e-6,
        received_us=(int(t_us.min()), int(t_us.max())),
        reception_jumps=int(((steps < 0) | (steps > RECEPTION_JUMP_US)).sum()),
        damage=frames.damage,
        messages=_messages(frames),
        vehicles=tuple(
            report for sysid in imu_systems(frames) if (report := _vehicle(frames, sysid))
        ),
    )


def imu_systems(frames: Frames) -> list[int]:
    """The system ids that send an IMU, in the order of their first one."""
    sysids = frames.sysid[np.isin(frames.msgid, IMU_IDS)]
    found, first = np.unique(sysids, return_index=True)
    return [int(sysid) for sysid in found[np.argsort(first)]]


def choose_system(frames: Frames, wanted: int | None = None) -> int:
    """The `wanted` system id, or the first that sends an IMU; LogFormatError where there is none
    such.
    """
    present = ", ".join(str(sysid) for sysid in np.unique(frames.sysid))
    if wanted is not None:
        if not (frames.sysid == wanted).any():
            raise LogFormatError(f"the log has no system {wanted}; it has {present}")
        return wanted
    vehicles = imu_systems(frames)
    if not vehicles:
        raise LogFormatError(f"no system in the log sends an IMU; name one of {present} (--sysid)")
    return vehicles[0]


def rate_and_gaps(t_us: IntArray) -> tuple[float, tuple[Gap, ...]]:
    """The rate in Hz by stamps (N,), and the holes between them."""
    intervals = np.diff(t_us)
    forward = intervals[intervals > 0]
    median = float(np.median(forward)) if len(forward) else 0.0
    hole = intervals > GAP_FACTOR * median
    # the median would mislead where stamps alternate, as ArduPilot's 2.5 and 5 ms do
    spacing = float(np.mean(forward[forward <= GAP_FACTOR * median])) if median else 0.0
    gaps = (Gap(int(t_us[k]), float(intervals[k]) * 1e-6) for k in np.flatnonzero(hole).tolist())
    return 1e6 / spacing if spacing else 0.0, tuple(gaps)


def _messages(frames: Frames) -> tuple[MessageCount, ...]:
    key = (frames.sysid << 8 | frames.compid) << 24 | frames.msgid
    order = np.argsort(key, kind="stable")
    _, first, counts = np.unique(key[order], return_index=True, return_counts=True)
    messages = []
    for start, count in zip(first.tolist(), counts.tolist(), strict=True):
        rows = order[start : start + count]
        span = float(frames.t_us[rows].max() - frames.t_us[rows].min()) * 1e-6
        i = int(rows[0])
        messages.append(
            MessageCount(
                int(frames.sysid[i]),
                int(frames.compid[i]),
                name_of(int(frames.msgid[i])),
                count,
                (count - 1) / span if span > 0.0 else 0.0,
            )
        )
    return tuple(sorted(messages, key=lambda m: (m.sysid, m.compid, -m.count, m.name)))


def _vehicle(frames: Frames, sysid: int) -> VehicleReport | None:
    """The report of one system, or None if none of its IMU samples is usable."""
    chosen = _choose_imu(frames, sysid)
    if chosen is None:
        return None
    compid, kind, imu_id, indices = chosen
    rows = decode_imu(frames, indices)
    usable = rows.valid & (rows.imu_id == imu_id)
    clock = Clock()
    times = clock.map_imu(
        rows.stamp_us[usable], frames.t_us[indices][usable], kind in WRAPPING_IMU_KINDS
    )
    t_us = times.t_us[times.keep]
    if not len(t_us):
        return None
    rate, gaps = rate_and_gaps(t_us)
    vehicle_type, autopilot = _heartbeat(frames, sysid, compid)
    sources = resolve(
        SourceSettings(),
        GnssSettings(),
        HeadingSettings(),
        _MAV_AUTOPILOT_INVALID if autopilot is None else autopilot,
    )
    fixes, utc = _gnss(frames, sysid, clock)
    truth = truth_of(frames, sysid)
    kinds = [event.kind for event in times.events]
    return VehicleReport(
        sysid=sysid,
        compid=compid,
        autopilot=autopilot,
        vehicle_type=vehicle_type,
        imu=kind,
        imu_id=imu_id,
        imu_rate=rate,
        imu_count=len(t_us),
        t_us=(int(t_us[0]), int(t_us[-1])),
        gaps=gaps,
        reboots=kinds.count("reboot"),
        jumps=kinds.count("jump"),
        wild_stamps=times.wild_stamps + times.zero_stamps,
        unusable=int((~rows.valid).sum()),
        sources=sources,
        gnss_fixes=fixes,
        gnss_is_utc=utc,
        truth=None if truth is None else truth.source,
        truth_count=0 if truth is None else len(truth),
    )


def _choose_imu(frames: Frames, sysid: int) -> tuple[int, str, int, IntArray] | None:
    """(compid, message, sensor id, indices) of the IMU that the intake would choose."""
    at = np.flatnonzero((frames.sysid == sysid) & np.isin(frames.msgid, IMU_IDS))
    source = ImuSource(Counter())
    for i in at.tolist():
        if source.offer(frames, i):
            break
    if source.chosen is None or source.compid is None:
        return None
    msgid, imu_id = source.chosen
    of_kind = at[(frames.msgid[at] == msgid) & (frames.compid[at] == source.compid)]
    return source.compid, source.name, imu_id, of_kind


def _heartbeat(frames: Frames, sysid: int, compid: int) -> tuple[int | None, int | None]:
    """(MAV_TYPE, MAV_AUTOPILOT) of a component's first HEARTBEAT."""
    fields = fields_of("HEARTBEAT")
    mine = (frames.sysid == sysid) & (frames.compid == compid) & (frames.msgid == fields.msgid)
    at = np.flatnonzero(mine)[:1]
    if not len(at):
        return None, None
    row = payload_rows(frames, at, fields)[0]
    return int(row["type"]), int(row["autopilot"])


def _gnss(frames: Frames, sysid: int, clock: Clock) -> tuple[int, bool]:
    """How many GPS_RAW_INT with a 3-D fix a system sent, and whether they are stamped in UTC."""
    fields = fields_of("GPS_RAW_INT")
    at = np.flatnonzero((frames.sysid == sysid) & (frames.msgid == fields.msgid))
    rows = payload_rows(frames, at, fields)
    good = rows["fix_type"] >= 3
    stamps = rows["time_usec"][good].astype(np.int64)
    utc = len(stamps) > 0 and is_unix(int(np.median(stamps))) and not is_unix(clock.newest_us or 0)
    return int(good.sum()), utc
