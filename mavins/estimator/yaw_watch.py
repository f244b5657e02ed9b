"""Is the filter's yaw wrong? Where GNSS velocities contradict the filter for a while and motion shows another yaw.

Theory: docs/theory/yaw_without_magnetometer.md.
"""

from __future__ import annotations

from typing import Final

from mavins.aiding import gnss_velocity, heading
from mavins.estimator.fusion import Event
from mavins.estimator.motion import MotionAttitude
from mavins.filters import Filter, FilterState
from mavins.nav.earth import TangentFrame
from mavins.types import HeadingFix

EXPECTED: Final = 2.0
"""A NIS is no reason for doubt up to so many times its mean."""
MOST: Final = 10.0
"""What one velocity adds at most: an outlier alone is none."""
ENOUGH: Final = 20.0
SIGMAS: Final = 3.0


class YawWatch:
    """Sums up what final decisions say: doubt <- max(0, doubt + NIS - 2 m), for a velocity of m rows."""

    def __init__(self) -> None:
        self._doubt = 0.0

    def see(self, event: Event) -> None:
        """A final decision."""
        m = event.measurement
        if m.aiding == gnss_velocity.NAME and not m.quality and event.nis >= 0.0:
            excess = min(event.nis - EXPECTED * len(m.z), MOST)
            self._doubt = min(max(0.0, self._doubt + excess), ENOUGH + MOST)

    @property
    def doubts(self) -> bool:
        """True where velocities speak against the filter."""
        return self._doubt > ENOUGH

    def calm(self) -> None:
        """Forget what was: the filter has another yaw now."""
        self._doubt = 0.0

    def contradiction(
        self, algorithm: Filter, state: FilterState, frame: TangentFrame, seen: MotionAttitude
    ) -> Event | None:
        """The yaw that motion shows at the state's time, not to be fused, where it is not the filter's."""
        fix = HeadingFix(state.t_us, seen.yaw, seen.sigma, "motion")
        m = heading.measure(fix, state.t_us, frame, seen.sigma, SIGMAS)
        event = Event(m, (state.t_us, m.rank, m.source, 0), "yaw reset")
        event.nis, event.innovation, event.S = algorithm.update(state, m, -1.0)
        return event if event.nis > SIGMAS**2 else None
