"""A simulator's truth beside a live estimate: for the status and the summary only.

The truth of an instant is moved to the estimate's, a few milliseconds away, by its own velocity and the
measured body rate.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mavins.mavlink.codec import Frames, HilState, decode_truth, fields_of
from mavins.nav.earth import dcm_ne, lla_to_ecef
from mavins.nav.so3 import quat_exp, quat_mul, quat_to_euler, wrap_pi
from mavins.status import TruthError
from mavins.types import NavSolution

HIL_STATE: Final = fields_of("HIL_STATE_QUATERNION").msgid
_APART_US: Final = 100_000


def error_of(truth: HilState, solution: NavSolution) -> TruthError | None:
    """Estimate minus truth at the estimate's instant; None where the two lie more than 0.1 s apart."""
    apart_us = solution.t_us - truth.stamp_us
    if abs(apart_us) > _APART_US:
        return None
    dt = apart_us * 1e-6
    C_le = dcm_ne(truth.lat, truth.lon)
    difference = lla_to_ecef(solution.lat, solution.lon, solution.alt) - lla_to_ecef(
        truth.lat, truth.lon, truth.alt
    )
    pos = C_le @ difference - np.array(truth.v_l) * dt
    vel = solution.v_l - np.array(truth.v_l)
    q = quat_mul(np.array(truth.q_lb), quat_exp(solution.w_b * dt))
    euler = quat_to_euler(q)
    return TruthError(
        tuple(pos.tolist()),
        tuple(vel.tolist()),
        (
            wrap_pi(solution.roll - euler[0]),
            wrap_pi(solution.pitch - euler[1]),
            wrap_pi(solution.yaw - euler[2]),
        ),
    )


class LiveTruth:
    """The errors of one vehicle's estimates, as its truth comes in."""

    def __init__(self) -> None:
        self.last: TruthError | None = None
        self.seen = 0
        self._squares = np.zeros((3, 3))
        self._largest = np.zeros((3, 3))

    def take(self, frames: Frames, sysid: int, solution: NavSolution | None) -> None:
        """Look for truth among a datagram's packets."""
        for i in np.flatnonzero((frames.msgid == HIL_STATE) & (frames.sysid == sysid)).tolist():
            truth = decode_truth(frames, i)
            if solution is None or not isinstance(truth, HilState):
                continue
            error = error_of(truth, solution)
            if error is not None:
                self.last = error
                self.seen += 1
                table = np.array([error.pos, error.vel, np.degrees(error.att)])
                self._squares += table**2
                self._largest = np.maximum(self._largest, np.abs(table))

    def summary(self) -> dict[str, Any] | None:
        """RMS and maximum per axis as in a replay's summary; None where no truth came."""
        if not self.seen:
            return None
        names = ("pos_m", "vel_m_s", "att_deg")
        rms = np.sqrt(self._squares / self.seen)
        return {
            "source": "HIL_STATE_QUATERNION",
            "instants": self.seen,
            "rms": {name: row.tolist() for name, row in zip(names, rms, strict=True)},
            "max": {name: row.tolist() for name, row in zip(names, self._largest, strict=True)},
        }
