"""Other settings for an estimator at work: which of them may change, and when the filter has to be made anew.

A change takes effect at its place among the samples, so a run with one gives the same bits whenever it is run again.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, TypeVar

from mavins.estimator.settings import Settings
from mavins.filters import FilterState, ImuNoise
from mavins.nav.layout import TAU, X_TAU, Layout

SETTINGS = TypeVar("SETTINGS", bound=Settings)

FIXED: Final = {
    "imu.rotation": "buffered samples are turned already",
    "imu.delay": "the samples' stamps would jump",
    "gnss.lever_arm": "the estimate would jump with it",
    "states": "the covariance and the result files have one layout",
    "magnetometer.enabled": "it decides what is read of the messages",
    "magnetometer.declination_deg": "auto may lack the World Magnetic Model, which shows at a start",
    "magnetometer.inclination_deg": "auto may lack the World Magnetic Model, which shows at a start",
    "estimator.buffer": "what a longer one should hold is gone",
}
"""Dotted paths of what only a start can change, and why."""


def applicable(old: Settings, wanted: SETTINGS) -> SETTINGS:
    """`wanted`, but with all that is FIXED as it is in `old`."""
    for path in FIXED:
        wanted = _with(wanted, path.split("."), old)
    return wanted


def _with(wanted: Any, path: list[str], source: Any) -> Any:
    """A copy of `wanted` that has what `source` has at a path."""
    name, *rest = path
    value = getattr(source, name)
    if rest:
        value = _with(getattr(wanted, name), rest, value)
    return dataclasses.replace(wanted, **{name: value})


def imu_noise(settings: Settings) -> ImuNoise:
    """The noises that a filter takes the IMU to have."""
    imu = settings.imu
    walks = settings.states.walks()
    return ImuNoise(imu.gyro_noise, imu.accel_noise, imu.gyro_bias_walk, imu.accel_bias_walk, walks)


def needs_filter(old: Settings, new: Settings) -> bool:
    """True where the filter, or what fuses measurements into it, depends on what has changed."""
    return (
        imu_noise(old) != imu_noise(new)
        or old.filters != new.filters
        or old.gnss.reset_after != new.gnss.reset_after
    )


def delay_told(old: Settings, new: Settings) -> bool:
    """True where the delay of fixes is said to be another one."""
    return (old.gnss.delay, old.gnss.utc_delay) != (new.gnss.delay, new.gnss.utc_delay)


def begin_delay(state: FilterState, layout: Layout, delay: float, sigma: float) -> None:
    """Estimate the delay of GNSS (s) anew, from this value and 1-sigma on; all else stays as it is known."""
    k = layout.columns.tolist().index(TAU.start)
    state.x[X_TAU] = delay
    state.P[k, :] = 0.0
    state.P[:, k] = 0.0
    state.P[k, k] = sigma**2
