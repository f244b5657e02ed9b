"""What a run saw and decided, as summary.json tells it."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from mavins.estimator.estimator import Estimator
from mavins.mavlink.clock import Clock
from mavins.mavlink.intake import Intake
from mavins.types import Origin


def summarize(estimator: Estimator, intake: Intake) -> dict[str, Any]:
    """What a run saw and decided: messages, drops, aidings with their innovation statistics, health."""
    monitor = None if intake.watcher is None else intake.watcher.summary()
    return {
        "imu": None
        if intake.imu.chosen is None
        else {"message": intake.imu.name, "id": intake.imu.chosen[1]},
        "sources": None if intake.sources is None else asdict(intake.sources),
        "messages": dict(intake.counts),
        "rates_hz": intake.rates(),
        "dropped": {k: v for k, v in (intake.dropped + estimator.dropped).items() if v},
        "reboots": intake.reboots,
        "utc_offset_us": _utc_offset_us(intake.clock),
        **outcome_of(estimator),
        **({} if monitor is None else {"monitor": monitor}),
    }


def outcome_of(estimator: Estimator) -> dict[str, Any]:
    """What an estimator decided: aidings with their innovation statistics, health, resets."""
    origin = None if estimator.frame is None else estimator.frame.origin
    return {
        **({} if origin is None else {"origin": _place(origin)}),
        "imu_samples": estimator.imu_rows,
        "aiding": {name: s.summary() for name, s in estimator.statistics.items()},
        "health": estimator.health.name.lower(),
        "reason": estimator.reason,
        "resets": estimator.reset_counter,
        "realignments": estimator.realignments,
    }


def _place(origin: Origin) -> dict[str, float]:
    lat_deg, lon_deg = math.degrees(origin.lat), math.degrees(origin.lon)
    return {"lat_deg": lat_deg, "lon_deg": lon_deg, "alt_m": origin.alt}


def _utc_offset_us(clock: Clock) -> int | None:
    """UTC minus the clock of the stamps, as the vehicle told it last."""
    newest_us = clock.newest_us
    unix_us = None if newest_us is None else clock.unix_of(newest_us)
    return None if newest_us is None or unix_us is None else unix_us - newest_us
