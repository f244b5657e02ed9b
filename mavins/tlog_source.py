"""One vehicle of a telemetry log into an estimator, as a live session would have fed it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavins.config import Config
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Feed
from mavins.logs.sensor_log import Choice
from mavins.logs.tlog import read_tlog
from mavins.logs.truth import Truth, truth_of
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


def vehicle_of(frames: Frames, wanted: int | None = None) -> int:
    """The `wanted` sysid if it sends an IMU, or the first that does; LogFormatError if there is none."""
    senders = frames.sysid[np.isin(frames.msgid, list(IMU_KINDS))]
    if not len(senders):
        raise LogFormatError(
            "the log has no IMU messages (HIGHRES_IMU, SCALED_IMU, RAW_IMU): "
            "nothing to estimate from; see what it holds with: mavins info LOG"
        )
    if wanted is not None and wanted not in senders:
        have = ", ".join(str(sysid) for sysid in np.unique(senders).tolist())
        raise LogFormatError(f"vehicle {wanted} sends no IMU messages in this log; {have} does")
    return int(senders[0]) if wanted is None else wanted


class TlogSource:
    """One vehicle of a telemetry log."""

    def __init__(
        self, log: Path, config: Config, sysid: int | None = None, choice: Choice | None = None
    ) -> None:
        self._frames = frames = read_tlog(log)
        self._sysid = vehicle_of(frames, sysid)
        self.config = config
        self._who = our_identity(frames, self._sysid, config.mavlink)
        self.seconds = (int(frames.t_us[-1]) - int(frames.t_us[0])) * 1e-6
        self.damage = {
            name: getattr(frames.damage, name)
            for name in ("bad_crc", "unknown", "skipped_bytes", "truncated")
        }
        self.truth = truth_of(frames, self._sysid)
        self.reference: Truth | None = None

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """The vehicle's packets through an intake."""
        sysid = self._sysid
        self._intake = Intake(estimator, self.config.sources)
        store = ConfigStore(self.config, partial(tune, self._intake), keep=lambda config: "")
        _feed(self._intake, store, self._frames, sysid, self._who, progress)
        if self._intake.imu.chosen is None:
            raise LogFormatError(f"the log has no usable IMU messages of vehicle {sysid}")

    def speaker(self) -> tuple[int, Identity]:
        """The vehicle's sysid, and under which ids a service speaks about it."""
        who = self._who or identity_for(self._sysid, self.config.mavlink, (), ())
        return self._sysid, who

    def received_us(self, t_us: int) -> int:
        """When the sample of an instant came in, on the clock of who wrote the log."""
        return t_us + self._intake.clock.lag_us

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What the intake saw, and what the estimator made of it."""
        return {"sysid": self._sysid, **summarize(estimator, self._intake)}


def our_identity(frames: Frames, sysid: int, settings: SessionSettings) -> Identity | None:
    """Under which ids a live session, seeing these packets, speaks about a vehicle; None for one without an IMU."""
    imu_at = np.flatnonzero(np.isin(frames.msgid, list(IMU_KINDS)))
    vehicles, first = np.unique(frames.sysid[imu_at], return_index=True)
    ours: dict[int, Identity] = {}
    for k in np.argsort(first).tolist():
        vehicle = int(vehicles[k])
        taken = {who.sysid for who in ours.values()}
        if vehicle not in taken or settings.persona == "companion":
            before = slice(imu_at[first[k]] + 1)
            told = ~np.isin(frames.msgid[before], SPOKEN)
            seen = set(frames.sysid[before][told].tolist())
            ours[vehicle] = identity_for(vehicle, settings, seen, taken)
    return ours.get(sysid)


def tune(intake: Intake, config: Config) -> None:
    """Put a changed configuration into force, live and again in a replay."""
    intake.reconfigure(config, config.filter, config.sources)


def _feed(
    intake: Intake,
    store: ConfigStore,
    frames: Frames,
    sysid: int,
    who: Identity | None,
    progress: Callable[[float], None],
) -> None:
    """All of a vehicle's packets, and between them what others asked of us, who speak as `who`."""
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
        progress(end / len(chosen))


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
