"""One vehicle of a telemetry log into an estimator, as a live session would have fed it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from mavins.config import Config
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Feed
from mavins.logs.sensor_log import DEFAULT, Choice, chosen
from mavins.logs.tlog import Tlog
from mavins.logs.truth import Truth
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
from mavins.mavlink.sources import GnssSource
from mavins.outcome import summarize
from mavins.parameters import ConfigStore
from mavins.tlog_survey import Survey
from mavins.types import Origin

CHANGES = np.array([SET_GPS_GLOBAL_ORIGIN, COMMAND_INT, COMMAND_LONG, PARAM_SET])
"""What others may have asked of us, which a recording holds only where it was carried out."""
RECEIVERS = {"1": "gps_raw_int", "2": "gps2_raw"}
"""The number of a receiver -> what speaks of it."""
CHUNK = 20_000
"""Packets between two reports of progress."""


def imu_of(survey: Survey, wanted: str | None) -> str | None:
    """The IMU message that is asked for; LogFormatError where the vehicle does not send it."""
    if wanted is None:
        return None
    names = sorted(survey.imu_messages[survey.check()])
    return chosen("IMU message", wanted.upper(), names, "")


def without_others(frames: Frames, sysid: int, imu: str) -> Frames:
    """The packets without those of a vehicle's other IMU messages."""
    others = [msgid for msgid, name in IMU_KINDS.items() if name != imu]
    return frames.select(~((frames.sysid == sysid) & np.isin(frames.msgid, others)))


def with_gnss(config: Config, wanted: str | None) -> Config:
    """The configuration with the `wanted` GNSS message; LogFormatError if none is called so."""
    if wanted is None:
        return config
    names = get_args(GnssSource)
    name = chosen("GNSS message", RECEIVERS.get(wanted, wanted.lower()), names, "")
    sources = replace(config.sources, gnss=cast(GnssSource, name))
    return replace(config, sources=sources)


class TlogSource:
    """One vehicle of a telemetry log."""

    def __init__(
        self, log: Path, config: Config, sysid: int | None = None, choice: Choice = DEFAULT
    ) -> None:
        self._blocks = Tlog(log)
        self._survey = survey = Survey(config.mavlink, sysid)
        for frames in self._blocks:
            survey.see(frames)
        self._sysid = survey.check()
        self._imu = imu_of(survey, choice.imu)
        self.config = with_gnss(config, choice.gnss)
        if choice.reference is not None:
            raise LogFormatError("telemetry holds no references to choose from: --reference")
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
            used = frames if self._imu is None else without_others(frames, self._sysid, self._imu)
            for t_us in _feed(intake, store, used, self._sysid, self._survey.identity):
                progress((t_us - first_us) / max(1, last_us - first_us))
        progress(1.0)
        if intake.imu.chosen is None:
            raise LogFormatError(f"the log has no usable IMU messages of vehicle {self._sysid}")

    def speaker(self) -> tuple[int, Identity]:
        """The vehicle's sysid, and under which ids a service speaks about it."""
        who = self._survey.identity or identity_for(self._sysid, self.config.mavlink, (), ())
        return self._sysid, who

    def received_us(self, t_us: int) -> int:
        """When the sample of an instant came in, on the clock of who wrote the log."""
        return t_us + self._intake.clock.lag_us

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
