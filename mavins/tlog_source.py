"""One vehicle of a telemetry log into an estimator, as a live session would have fed it."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavins.config import Config
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Feed
from mavins.logs.sensor_log import Choice
from mavins.logs.tlog import Tlog
from mavins.logs.truth import Truth, joined, truth_of
from mavins.mavlink.asking import SPOKEN
from mavins.mavlink.codec import IMU_KINDS, Frames, OriginRequest, decode
from mavins.mavlink.commands import (
    COMMAND_INT,
    COMMAND_LONG,
    STORE_PARAMETERS,
    Command,
    carry_out,
    keep_parameters,
)
from mavins.mavlink.identity import identity_for
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.mavlink.parameters import PARAM_SET, set_again
from mavins.mavlink.peers import Identity
from mavins.mavlink.requests import SET_GPS_GLOBAL_ORIGIN, decode_packet, is_for
from mavins.mavlink.settings import SessionSettings
from mavins.outcome import summarize
from mavins.parameters import ConfigStore
from mavins.types import Origin

CHANGES = np.array([SET_GPS_GLOBAL_ORIGIN, COMMAND_INT, COMMAND_LONG, PARAM_SET])
"""What others may have asked of us, which a recording holds only where it was carried out."""
CHUNK = 20_000
"""Packets between two reports of progress."""


class Survey:
    """What is to be known of a telemetry log before it is fed, gathered block by block.

    `vehicle` is the wanted system, or the first that sends an IMU; `identity` the ids under which a live session,
    seeing these packets, speaks about it; `t_us` when the first and the last packet came; `truth` is for evaluation.
    """

    def __init__(self, settings: SessionSettings, wanted: int | None = None) -> None:
        self.senders: list[int] = []
        self.t_us: tuple[int, int] | None = None
        self.damage: Counter[str] = Counter()
        self._settings = settings
        self._wanted = wanted
        self._ours: dict[int, Identity] = {}
        self._seen: set[int] = set()
        self._truth: list[Truth] = []

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
        truth = None if vehicle is None else truth_of(frames, vehicle)
        if truth is not None:
            self._truth.append(truth)

    def _meet(self, frames: Frames) -> None:
        """Give an identity to each vehicle whose first IMU message is here."""
        told = ~np.isin(frames.msgid, SPOKEN)
        imu_at = np.flatnonzero(np.isin(frames.msgid, list(IMU_KINDS)))
        vehicles, first = np.unique(frames.sysid[imu_at], return_index=True)
        for k in np.argsort(first).tolist():
            vehicle = int(vehicles[k])
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


class TlogSource:
    """One vehicle of a telemetry log."""

    def __init__(
        self, log: Path, config: Config, sysid: int | None = None, choice: Choice | None = None
    ) -> None:
        self._blocks = Tlog(log)
        self._survey = survey = Survey(config.mavlink, sysid)
        for frames in self._blocks:
            survey.see(frames)
        self._sysid = survey.check()
        self.config = config
        first_us, last_us = survey.t_us or (0, 0)
        self.seconds = (last_us - first_us) * 1e-6
        self.damage = dict(survey.damage)
        self.truth = survey.truth
        self.reference: Truth | None = None

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """The vehicle's packets through an intake."""
        self._intake = intake = Intake(estimator, self.config.sources)
        store = ConfigStore(self.config, partial(tune, intake), keep=lambda config: "")
        first_us, last_us = self._survey.t_us or (0, 0)
        for frames in self._blocks:
            for t_us in _feed(intake, store, frames, self._sysid, self._survey.identity):
                progress((t_us - first_us) / max(1, last_us - first_us))
        progress(1.0)
        if intake.imu.chosen is None:
            raise LogFormatError(f"the log has no usable IMU messages of vehicle {self._sysid}")

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What the intake saw, and what the estimator made of it."""
        return {"sysid": self._sysid, **summarize(estimator, self._intake)}


def tune(intake: Intake, config: Config) -> None:
    """Put a changed configuration into force, live and again in a replay."""
    intake.reconfigure(config, config.filter, config.sources)


def _feed(
    intake: Intake,
    store: ConfigStore,
    frames: Frames,
    sysid: int,
    who: Identity | None,
) -> Iterator[int]:
    """All of a vehicle's packets, and between them what others asked of us, who speak as `who`; gives how far it is."""
    relevant = (frames.sysid == sysid) & np.isin(frames.msgid, RELEVANT)
    if who is not None:
        relevant &= (frames.sysid != who.sysid) | (frames.compid != who.compid)
    chosen = frames.select(relevant | np.isin(frames.msgid, CHANGES))
    at = np.flatnonzero(np.isin(chosen.msgid, CHANGES))
    edges = np.unique(np.concatenate([np.arange(0, len(chosen), CHUNK), at, at + 1]))
    for start, end in itertools.pairwise([*edges.tolist(), len(chosen)]):
        if start == end:
            continue
        part = chosen.select(np.arange(start, end))
        if part.msgid[0] not in CHANGES:
            intake.take(part)
        elif who is not None:
            _change(intake.estimator, store, part, who)
        yield int(part.t_us[-1])


def _change(estimator: Feed, store: ConfigStore, frames: Frames, who: Identity) -> None:
    """Carry out again what was asked of us."""
    if frames.msgid[0] == SET_GPS_GLOBAL_ORIGIN:
        request = decode(frames, 0)
        if isinstance(request, OriginRequest) and request.target_system in (0, who.sysid):
            estimator.set_origin(Origin(request.lat, request.lon, request.alt))
        return
    message = decode_packet(frames, 0)
    if message is None or not is_for(message, who):
        return
    if message.get_msgId() == PARAM_SET:
        set_again(message, store)
        return
    command = Command.of(message)
    if command.number == STORE_PARAMETERS:
        keep_parameters(command, store)
    else:
        carry_out(command, estimator)
