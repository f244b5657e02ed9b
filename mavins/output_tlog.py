"""The messages that a service would have sent about a log's vehicle, made by what makes them live, into a .tlog.

Not among them: what the autopilot alone is given or asked for, answers to requests, and what a monitor says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

import numpy as np

from mavins.config import Config
from mavins.estimator.estimator import Estimator
from mavins.estimator.feed import Relay
from mavins.logs.tlog import TlogWriter
from mavins.mavlink.codec import Payload, frame
from mavins.mavlink.intake import Intake
from mavins.mavlink.peers import Identity
from mavins.mavlink.vehicle import Holder, Vehicle
from mavins.types import GnssFix, ImuTable, IntArray

_TICK_US: Final = 50_000
"""How often a service looks at its own clock."""


class OutputLog(Relay):
    """Stands in front of an estimator, lets it stop where messages are due, and writes them.

    `received_us` tells when a service would have had the sample of an instant, which is when it would have spoken.
    """

    def __init__(
        self,
        path: Path,
        estimator: Estimator,
        config: Config,
        sysid: int,
        identity: Identity,
        received_us: Callable[[int], int],
    ) -> None:
        super().__init__(estimator)
        self._received_us = received_us
        self._identity = identity
        self._estimator = estimator
        self._intake = Intake(self, config.sources)
        self._vehicle = Vehicle(
            sysid,
            identity,
            estimator,
            self._intake,
            Holder(None, 0),
            config.streams,
            round(config.mavlink.vehicle_timeout * 1e6),
            config.mavlink.persona,
        )
        rates = config.streams.rates(config.mavlink.persona)
        periods = {round(1e6 / rate) for rate in rates.values() if rate > 0.0}
        self._periods_us = np.array(sorted(periods), dtype=np.int64)
        self._sequence = 0
        self._now_us = 0
        self._tick_us = 0
        self._log = TlogWriter(path)

    def feed_imu(self, table: ImuTable) -> None:
        """Hand on IMU samples up to each that makes a message due."""
        start = 0
        for end in (*self._stops(table.t_us), len(table)):
            if end > start:
                self.feed.feed_imu(table[start:end])
                self._speak()
                start = end

    def feed_gnss(self, fix: GnssFix) -> None:
        """Hand on a fix; it is told once."""
        self.feed.feed_gnss(fix)
        self._intake.fixes.last = fix
        self._say(self._vehicle.look(self._now_us))

    def close(self) -> None:
        """Write what is held."""
        self._log.close()

    def _stops(self, t_us: IntArray) -> list[int]:
        """The rows behind which a message may be due."""
        slots = t_us[:, np.newaxis] // self._periods_us
        due = (slots[1:] != slots[:-1]).any(axis=1)
        # the first row is told by the plan: it alone knows what was before
        stops: list[int] = [1, *(np.flatnonzero(due) + 2).tolist()]
        return stops

    def _speak(self) -> None:
        """Write what is due at the estimator's newest instant."""
        t_us = self._estimator.t_us
        if t_us is None:
            return
        vehicle = self._vehicle
        # a service's clock does not step back
        self._now_us = now_us = max(self._now_us, self._received_us(t_us))
        vehicle.holder.seen_us = now_us
        self._say(vehicle.look(now_us))
        due = vehicle.estimate_due()
        names = [] if due is None else due.usual
        if now_us >= self._tick_us:
            self._tick_us = now_us + _TICK_US
            names = [*names, *vehicle.service_due(now_us).usual]
            self._say(vehicle.tick(now_us))
        telemetry = vehicle.telemetry()
        made = (telemetry[name] for name in names)
        self._say(payload for payload in made if payload is not None)

    def _say(self, payloads: Iterable[Payload]) -> None:
        for payload in payloads:
            self._log.write(self._now_us, frame(payload, *self._identity, self._sequence))
            self._sequence = (self._sequence + 1) % 256
