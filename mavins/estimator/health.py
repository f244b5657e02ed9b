"""Is an estimate worth sending? What is looked at a few times a second, and the word that goes with it."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from mavins.aiding import heading
from mavins.estimator.fusion import Track
from mavins.estimator.settings import EstimatorSettings
from mavins.filters import FilterState
from mavins.types import Health

RESETS_TO_DIVERGE: Final = 3
DIVERGE_WITHIN_US: Final = 60_000_000
YAW_SILENT_US: Final = 5_000_000
YAW_SIGMA: Final = math.radians(8.0)
"""Without a heading for this long and with a larger sigma, the status says that yaw is not observable."""


class Verdict(NamedTuple):
    """The health of an estimate, and why; DIVERGED: it must be given up."""

    health: Health
    reason: str


def judged(
    state: FilterState, track: Track, now_us: int, settings: EstimatorSettings, complaint: str
) -> Verdict:
    """The verdict on a state at `now_us`; `complaint` is the filter's own."""
    lately = [t for t in track.reset_times_us if now_us - t < DIVERGE_WITHIN_US]
    if complaint:
        return Verdict(Health.DIVERGED, complaint)
    if len(lately) >= RESETS_TO_DIVERGE:
        return Verdict(Health.DIVERGED, f"{len(lately)} resets within a minute")
    if math.sqrt(max(state.P[0, 0], state.P[1, 1])) > settings.max_position_sigma:
        return Verdict(Health.DIVERGED, "position sigma beyond its limit")
    silent = (now_us - max(track.accepted_us[0], track.accepted_us[1])) * 1e-6
    if silent > settings.dead_reckoning_after:
        return Verdict(Health.DEAD_RECKONING, f"no GNSS accepted for {silent:.0f} s")
    return Verdict(Health.RUNNING, _yaw_remark(state, track, now_us))


def _yaw_remark(state: FilterState, track: Track, now_us: int) -> str:
    """A word where the heading is on its own: no heading for some seconds, and its sigma has grown."""
    sigma = math.sqrt(float(state.P[8, 8]))
    silent_us = now_us - track.accepted_us[heading.RANK]
    if silent_us <= YAW_SILENT_US or sigma <= YAW_SIGMA:
        return ""
    return f"yaw not observable (sigma {math.degrees(sigma):.0f} deg): no heading, no acceleration"
