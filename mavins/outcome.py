"""What a run saw and decided, as summary.json tells it."""

from __future__ import annotations

from typing import Any

from mavins.estimator.estimator import Estimator
from mavins.mavlink.intake import Intake


def summarize(estimator: Estimator, intake: Intake) -> dict[str, Any]:
    """What a run saw and decided: messages, drops, aidings with their innovation statistics, health."""
    monitor = None if intake.watcher is None else intake.watcher.summary()
    return {
        "imu": None
        if intake.imu.chosen is None
        else {"message": intake.imu.name, "id": intake.imu.chosen[1]},
        "messages": dict(intake.counts),
        "rates_hz": intake.rates(),
        "dropped": {k: v for k, v in (intake.dropped + estimator.dropped).items() if v},
        "reboots": intake.reboots,
        **outcome_of(estimator),
        **({} if monitor is None else {"monitor": monitor}),
    }


def outcome_of(estimator: Estimator) -> dict[str, Any]:
    """What an estimator decided: aidings with their innovation statistics, health, resets."""
    return {
        "imu_samples": estimator.imu_rows,
        "aiding": {name: s.summary() for name, s in estimator.statistics.items()},
        "health": estimator.health.name.lower(),
        "reason": estimator.reason,
        "resets": estimator.reset_counter,
        "realignments": estimator.realignments,
    }
