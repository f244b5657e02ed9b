"""What is to be known of a telemetry log before it is fed: vehicles, who speaks about them, its length, the truth."""

from __future__ import annotations

from collections import Counter

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs.truth import Truth, joined, truth_of
from mavins.mavlink.asking import SPOKEN
from mavins.mavlink.codec import IMU_KINDS, Frames
from mavins.mavlink.identity import identity_for
from mavins.mavlink.peers import Identity
from mavins.mavlink.settings import SessionSettings
from mavins.tlog_reference import AutopilotReference


class Survey:
    """What is to be known of a telemetry log before it is fed, gathered block by block.

    `vehicle` is the wanted system, or the first that sends an IMU; `identity` the ids under which a live session,
    seeing these packets, speaks about it; `t_us` when the first and the last packet came; `imu_messages` what IMU
    messages each system sends; `truth` and `reference`, what the autopilot's own filter said, are for evaluation.
    """

    def __init__(self, settings: SessionSettings, wanted: int | None = None) -> None:
        self.senders: list[int] = []
        self.imu_messages: dict[int, set[str]] = {}
        self.t_us: tuple[int, int] | None = None
        self.damage: Counter[str] = Counter()
        self._settings = settings
        self._wanted = wanted
        self._ours: dict[int, Identity] = {}
        self._seen: set[int] = set()
        self._truth: list[Truth] = []
        self._autopilot = AutopilotReference()

    @property
    def vehicle(self) -> int | None:
        """The system that is estimated, as far as is known."""
        return self._wanted if self._wanted is not None else next(iter(self.senders), None)

    @property
    def identity(self) -> Identity | None:
        """Who speaks about the vehicle; None where it sends no IMU."""
        return None if self.vehicle is None else self._ours.get(self.vehicle)

    @property
    def truth(self) -> Truth | None:
        """All of the simulator's truth about the vehicle."""
        return joined(self._truth)

    @property
    def reference(self) -> Truth | None:
        """What the vehicle's autopilot said, if it has a filter."""
        return self._autopilot.truth()

    def see(self, frames: Frames) -> None:
        """Look at a block."""
        for name in ("bad_crc", "unknown", "skipped_bytes", "truncated"):
            self.damage[name] += getattr(frames.damage, name)
        if not len(frames):
            return
        first_us = int(frames.t_us[0]) if self.t_us is None else self.t_us[0]
        self.t_us = (first_us, int(frames.t_us[-1]))
        self._meet(frames)
        vehicle = self.vehicle
        if vehicle is None:
            return
        self._autopilot.see(frames, vehicle)
        truth = truth_of(frames, vehicle)
        if truth is not None:
            self._truth.append(truth)

    def _meet(self, frames: Frames) -> None:
        """Give an identity to each vehicle whose first IMU message is here."""
        told = ~np.isin(frames.msgid, SPOKEN)
        imu_at = np.flatnonzero(np.isin(frames.msgid, list(IMU_KINDS)))
        vehicles, first = np.unique(frames.sysid[imu_at], return_index=True)
        for k in np.argsort(first).tolist():
            vehicle = int(vehicles[k])
            msgids = np.unique(frames.msgid[imu_at][frames.sysid[imu_at] == vehicle]).tolist()
            self.imu_messages.setdefault(vehicle, set()).update(map(IMU_KINDS.__getitem__, msgids))
            if vehicle in self.senders:
                continue
            self.senders.append(vehicle)
            taken = {who.sysid for who in self._ours.values()}
            if vehicle not in taken or self._settings.persona == "companion":
                before = slice(imu_at[first[k]] + 1)
                seen = self._seen | set(frames.sysid[before][told[before]].tolist())
                self._ours[vehicle] = identity_for(vehicle, self._settings, seen, taken)
        self._seen.update(np.unique(frames.sysid[told]).tolist())

    def check(self) -> int:
        """The vehicle; LogFormatError where it, or any, sends no IMU."""
        if not self.senders:
            raise LogFormatError(
                "the log has no IMU messages (HIGHRES_IMU, SCALED_IMU, RAW_IMU): "
                "nothing to estimate from; see what it holds with: mavins info LOG"
            )
        vehicle = self.vehicle
        if vehicle is None or vehicle not in self.senders:
            have = ", ".join(map(str, sorted(self.senders)))
            raise LogFormatError(
                f"vehicle {vehicle} sends no IMU messages in this log; {have} does"
            )
        return vehicle
