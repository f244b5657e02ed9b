"""A log of any kind as a source of samples, by what is in it."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from mavins.config import Config
from mavins.errors import LogFormatError
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Feed
from mavins.evaluation.tape import Tape
from mavins.logs.content import kind_of
from mavins.logs.feeding import feed_log, settled
from mavins.logs.sensor_log import DEFAULT, Choice, SensorLog
from mavins.logs.truth import Truth, judge_of
from mavins.mavlink.identity import identity_for
from mavins.mavlink.peers import Identity
from mavins.outcome import outcome_of
from mavins.tlog_source import TlogSource
from mavins.types import ImuTable

READERS: Final = {
    "csv_folder": "mavins.logs.csv_folder:read_csv_folder",
    "dataflash": "mavins.logs.dataflash:read_dataflash",
    "euroc": "mavins.logs.euroc:read_euroc",
    "kf_gins": "mavins.logs.kf_gins:read_kf_gins",
    "ulog": "mavins.logs.ulog:read_ulog",
}
"""Kind of a log -> what reads it, as module:function; imported when it is needed, for some need an extra."""


class Source(Protocol):
    """A log of any kind.

    `config` is the configuration with what the log itself decides; `seconds` is the log's length, `damage` what could
    not be read; `truth`, what a simulator knew, and `reference`, what the vehicle's own filter said, are for evaluation
    only.
    """

    config: Config
    seconds: float
    damage: dict[str, int]
    truth: Truth | None
    reference: Truth | None

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """All of the log into an estimator."""

    def speaker(self) -> tuple[int, Identity]:
        """The vehicle's sysid, and under which ids a service speaks about it."""

    def received_us(self, t_us: int) -> int:
        """When a service would have had the sample of an instant; since boot where the log tells no other clock."""

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What was fed, and what the estimator made of it."""


class SensorSource:
    """A log of sensors: everything but telemetry."""

    def __init__(self, log: SensorLog, config: Config) -> None:
        if not log.gnss:
            raise LogFormatError(
                "the log has no GNSS fixes: nowhere to start from; see what it holds with: mavins info LOG"
            )
        self._log = log
        self.config = settled(config, log)
        self.seconds = log.seconds
        self.damage = dict(log.damage)
        self.truth = log.truth
        self.reference = log.reference

    def feed(self, estimator: Feed, progress: Callable[[float], None]) -> None:
        """All tables, merged by their stamps."""
        feed_log(self._log, estimator, self.config, progress)

    def speaker(self) -> tuple[int, Identity]:
        """Such logs have no sysid: it is vehicle 1."""
        return 1, identity_for(1, self.config.mavlink, (), ())

    def received_us(self, t_us: int) -> int:
        """At the instant itself."""
        return t_us

    def summary(self, estimator: Estimator) -> dict[str, Any]:
        """What the tables hold, and what the estimator made of it."""
        log, counts = self._log, self._log.counts
        return {
            "imu": {"message": log.names["imu"], "id": 0},
            "sources": dict(log.names),
            "messages": counts,
            "rates_hz": {name: n / max(self.seconds, 1e-6) for name, n in counts.items()},
            "dropped": {k: v for k, v in (log.dropped + estimator.dropped).items() if v},
            **outcome_of(estimator),
        }


@dataclass(frozen=True, slots=True)
class Log:
    """A log of any kind, to be run as often as one likes.

    `kind` as its content tells, `sysid` the vehicle of a telemetry log (None: the first that sends an IMU), `choice`
    which of its sources are used. `sensors` are its tables; None for telemetry, which goes through the same intake as
    live.
    """

    path: Path
    kind: str
    sysid: int | None
    choice: Choice
    sensors: SensorLog | None

    def source(self, config: Config) -> Source:
        """The log as a source, with a configuration."""
        if self.sensors is None:
            return TlogSource(self.path, config, self.sysid, self.choice)
        return SensorSource(self.sensors, config)


def open_log(path: Path | str, sysid: int | None = None, choice: Choice = DEFAULT) -> Log:
    """The log that a path is, by its content, never by its name.

    LogFormatError for what is not a log, or lacks what was chosen.
    """
    path = Path(path)
    kind = kind_of(path)
    sensors = None if kind == "tlog" else read_sensors(path, kind, choice)
    return Log(path, kind, sysid, choice, sensors)


def source_of(
    log: Path, config: Config, sysid: int | None = None, choice: Choice = DEFAULT
) -> Source:
    """A log with a configuration, as `open_log` finds it."""
    return open_log(log, sysid, choice).source(config)


def read_sensors(log: Path, kind: str, choice: Choice = DEFAULT) -> SensorLog:
    """The sensors of a log of one of the kinds in `READERS`."""
    module, _, function = READERS[kind].partition(":")
    reader: Callable[[Path, Choice], SensorLog] = getattr(importlib.import_module(module), function)
    return reader(log, choice)


def tape_of(
    log: Path,
    config: Config,
    sysid: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
    choice: Choice = DEFAULT,
) -> tuple[Tape, Truth | None]:
    """What an estimator would be fed from a log, with the settings that go with it, and what to judge by."""
    source = source_of(log, config, sysid, choice)
    tape = Tape(source.config)
    source.feed(tape, progress)
    return tape, judge_of(source.truth, source.reference)


def imu_of(log: Path, config: Config, sysid: int | None = None) -> ImuTable:
    """All IMU samples of a log by their stamps; it need not hold anything else."""
    kind = kind_of(log)
    if kind == "tlog":
        tape = Tape(config)
        TlogSource(log, config, sysid).feed(tape, lambda _: None)
        tables = [what for name, what in tape.feeds if name == "feed_imu"]
    else:
        tables = [read_sensors(log, kind).imu]
    t_us, first = np.unique(np.concatenate([t.t_us for t in tables]), return_index=True)
    accel_b = np.concatenate([t.accel_b for t in tables])[first]
    return ImuTable(t_us, accel_b, np.concatenate([t.gyro_b for t in tables])[first])
