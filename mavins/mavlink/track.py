"""Our own solution at instants of the last seconds, to be held against what others say of the same instant."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final, Protocol

from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import quat_conj, quat_exp, quat_log, quat_mul, quat_to_dcm, wrap_pi
from mavins.types import FloatArray, NavSolution

REACH_US: Final = 100_000
"""The newest solution is moved on by at most this."""
SPAN_US: Final = 500_000
"""Two solutions farther apart have nothing between them."""
_KEPT: Final = 32


class Own(Protocol):
    """As much of an estimator as the monitor looks at."""

    @property
    def t_us(self) -> int | None:
        """The newest IMU stamp, or None."""

    @property
    def frame(self) -> TangentFrame | None:
        """Frame n."""

    def solution(self) -> NavSolution | None:
        """The estimate at the newest IMU stamp, or None."""

    def yaw_from_motion(self) -> tuple[float, float] | None:
        """(yaw in l, sigma) in rad at the newest IMU stamp without any heading, or None."""


@dataclass(frozen=True, slots=True)
class Instant:
    """Our solution at one instant: p_n, v_l, q_lb, the rates w_b, c_ln, and the 1-sigma of each quantity.

    `motion` is how far the yaw that motion alone shows is from ours, and its sigma.
    """

    t_us: int
    resets: int
    frame: TangentFrame
    p_n: FloatArray
    v_l: FloatArray
    q_lb: FloatArray
    w_b: FloatArray
    c_ln: FloatArray
    sigma: dict[str, float]
    motion: tuple[float, float] | None

    @classmethod
    def of(
        cls, solution: NavSolution, frame: TangentFrame, yaw: tuple[float, float] | None
    ) -> Instant:
        """Take from a solution what is compared."""
        c_ln = frame.local_level(solution.lat, solution.lon)
        c_lb = quat_to_dcm(solution.q_lb)
        variance = solution.P.diagonal().tolist()
        turn = ((c_lb @ solution.P[6:9, 6:9]) * c_lb).sum(axis=1).tolist()
        sigma = {
            "position": math.sqrt(variance[0] + variance[1]),
            "height": math.sqrt(variance[2]),
            "velocity": math.sqrt(sum(variance[3:6])),
            "tilt": math.sqrt(max(0.0, turn[0] + turn[1])),
            "yaw": math.sqrt(max(0.0, turn[2])),
        }
        return cls(
            solution.t_us,
            solution.reset_counter,
            frame,
            solution.p_n,
            solution.v_l,
            solution.q_lb,
            solution.w_b,
            c_ln,
            sigma,
            None if yaw is None else (wrap_pi(yaw[0] - solution.yaw), yaw[1]),
        )

    def moved(self, t_us: int) -> Instant:
        """A little later or earlier, with the velocity and the rates of this instant."""
        dt = (t_us - self.t_us) * 1e-6
        return self._with(
            t_us,
            self.p_n + dt * (self.c_ln.T @ self.v_l),
            self.v_l,
            quat_mul(self.q_lb, quat_exp(dt * self.w_b)),
        )

    def between(self, later: Instant, t_us: int) -> Instant:
        """On the way from here to a later instant: straight lines, and one turn at constant rate."""
        s = (t_us - self.t_us) / (later.t_us - self.t_us)
        turn = quat_log(quat_mul(quat_conj(self.q_lb), later.q_lb))
        return self._with(
            t_us,
            self.p_n + s * (later.p_n - self.p_n),
            self.v_l + s * (later.v_l - self.v_l),
            quat_mul(self.q_lb, quat_exp(s * turn)),
        )

    def _with(self, t_us: int, p_n: FloatArray, v_l: FloatArray, q_lb: FloatArray) -> Instant:
        return replace(self, t_us=t_us, p_n=p_n, v_l=v_l, q_lb=q_lb)


class Track:
    """The newest solutions of one estimator, as far as they were looked at."""

    def __init__(self, own: Own) -> None:
        self._own = own
        self._ring: deque[Instant] = deque(maxlen=_KEPT)

    def remember(self) -> bool:
        """Keep the newest solution; False where there is none, or where time went back: all others are then gone."""
        t_us, ring = self._own.t_us, self._ring
        if ring and t_us == ring[-1].t_us:
            return True
        went_back = bool(ring) and t_us is not None and t_us < ring[-1].t_us
        solution, frame = self._own.solution(), self._own.frame
        if solution is None or frame is None or went_back:
            ring.clear()
            return False
        ring.append(Instant.of(solution, frame, self._own.yaw_from_motion()))
        return True

    def at(self, t_us: int) -> Instant | None:
        """The solution at an instant, or None where there is none near it."""
        later: Instant | None = None
        for instant in reversed(self._ring):
            if instant.t_us <= t_us:
                if later is None:
                    return instant.moved(t_us) if t_us - instant.t_us <= REACH_US else None
                near = later.t_us - instant.t_us <= SPAN_US
                same = instant.resets == later.resets and instant.frame is later.frame
                return instant.between(later, t_us) if near and same else None
            later = instant
        return None


def tilt_and_yaw(q_lb: FloatArray, other_lb: FloatArray) -> tuple[float, float]:
    """The rotation q from attitude `other_lb` to `q_lb`, in l, as two angles in rad.

    Yaw is its turn about the vertical, 2 atan2(q_z, q_w) in (-pi, pi], tilt what is left, 2 atan2(|q_xy|, |q_wz|) >= 0;
    neither has the singularity of Euler angles.
    """
    w, x, y, z = quat_mul(q_lb, quat_conj(other_lb)).tolist()
    if w < 0.0:
        w, z = -w, -z
    return 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z)), 2.0 * math.atan2(z, w)
