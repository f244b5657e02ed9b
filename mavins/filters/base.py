"""What the estimator asks of every filter, and the state that a filter works on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, Protocol

import numpy as np

from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, X_SIZE, Layout, size_of
from mavins.types import FloatArray, IntArray

_NOTHING: Final = np.empty((0, 0))
GAP_NOISE: Final = 10.0
"""The root PSDs of gyro and accelerometer are this many times larger while a reading is held."""


def sigmas_of(S: FloatArray) -> FloatArray:
    """sqrt(diag S) (m,) of a covariance S (m, m); nan where that is not a positive number."""
    # by hand: numpy takes longer for three numbers
    return np.array([math.sqrt(v) if v >= 0.0 else math.nan for v in S.diagonal().tolist()])


@dataclass(slots=True)
class FilterState:
    """A filter's whole memory: nominal `x` (26,), covariance `P` (n, n), last IMU reading `u` (6,), time `t_us`.

    `u` is [gyro_b (3), accel_b (3)] as read, not bias-corrected, valid at t_us. Filters change the arrays in place.
    P is over the canonical errors of the filter's layout between any two calls, whatever errors the filter itself
    works in; `own` is for what a filter keeps beside it (a square root of P), and empty for most.
    """

    x: FloatArray
    P: FloatArray
    u: FloatArray
    t_us: int
    own: FloatArray = field(default_factory=lambda: _NOTHING)

    def copy(self) -> FilterState:
        """A copy that shares nothing with this one."""
        own = self.own.copy() if self.own.size else self.own
        return FilterState(self.x.copy(), self.P.copy(), self.u.copy(), self.t_us, own)


@dataclass(slots=True)
class RowBlock:
    """Estimates at consecutive instants, of which the first `count` are filled.

    t_us (N,), x (N, 26), u (N, 6), P (N, n, n) over the canonical errors of a layout.
    """

    t_us: IntArray
    x: FloatArray
    u: FloatArray
    P: FloatArray
    count: int = 0

    @classmethod
    def empty(cls, capacity: int, size: int = 15) -> RowBlock:
        """A block with room for `capacity` rows of a filter with `size` error states."""
        return cls(
            np.empty(capacity, dtype=np.int64),
            np.empty((capacity, X_SIZE)),
            np.empty((capacity, 6)),
            np.empty((capacity, size, size)),
        )


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Root PSDs of the IMU's errors: gyro rad/s/sqrt(Hz), accel m/s^2/sqrt(Hz), and the walks of their biases.

    `walks` are those of further states, by block, in their unit per sqrt(s); a block that is not there is constant.
    """

    gyro: float
    accel: float
    gyro_bias_walk: float
    accel_bias_walk: float
    walks: Mapping[str, float] = field(default_factory=dict)

    def as_array(self, layout: Layout) -> FloatArray:
        """The array (4 + k,) that the kernels take: the IMU's, then one for each of the layout's k further states."""
        imu = (self.gyro, self.accel, self.gyro_bias_walk, self.accel_bias_walk)
        further = layout.blocks[len(CORE) :]
        walks = [np.full(size_of(block), self.walks.get(block, 0.0)) for block in further]
        return np.concatenate([imu, *walks])

    def as_arrays(self, layout: Layout) -> tuple[FloatArray, FloatArray]:
        """`as_array`, and the same where the accelerometer was clipped."""
        return self.as_array(layout), replace(self, accel=GAP_NOISE * self.accel).as_array(layout)


class Observation(Protocol):
    """A measurement as a filter sees it: how far it is from what a state predicts."""

    @property
    def R(self) -> FloatArray:
        """The noise covariance (m, m)."""

    def linearize(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(r (m,), H (m, 25)): the residual z - h(x), and the Jacobian of h over the canonical errors."""

    def residuals(self, X: FloatArray, u: FloatArray) -> FloatArray:
        """The residuals (k, m) of nominal states X (k, 26)."""

    def differences(self, X: FloatArray, u: FloatArray, r: FloatArray) -> FloatArray:
        """The residuals (k, m) of X less the residual r (m,): the short way round where residuals are wrapped."""


class Outcome(NamedTuple):
    """What has become of a measurement: its NIS, the innovation (m,) and its covariance S (m, m), before the update."""

    nis: float
    innovation: FloatArray
    S: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """sqrt(diag S) (m,), nan where S is not positive."""
        return sigmas_of(self.S)


class Filter(Protocol):
    """A navigation filter over a `Layout` of error states."""

    layout: Layout

    def adopt(self, state: FilterState) -> None:
        """Take note that x or P was set or changed by somebody else: at a start, a reset, a change of frame."""

    def complaint(self, state: FilterState) -> str:
        """Why this filter cannot go on from `state`, though it is finite; nothing if it can."""

    def walk(
        self,
        state: FilterState,
        frame: TangentFrame,
        t_us: IntArray,
        imu: FloatArray,
        until_us: int,
        previous_us: int,
        grid_us: int,
        rows: RowBlock,
        clipped: bool = False,
    ) -> None:
        """Move `state` through IMU rows: stamps `t_us` (N,), readings `imu` (N, 6) as in FilterState.u.

        All rows up to `until_us` are walked; if the last row lies beyond it, the state goes on to that instant,
        with the reading on the line to that row.

        A row is appended to `rows` for the first stamp at or after each multiple of `grid_us` (every stamp if 0,
        none if negative); `previous_us` is the stamp of the IMU row before the first. `clipped`: the accelerometer
        was at its limit in all of these rows, and they say as little of the motion as a reading that is held.
        """

    def update(self, state: FilterState, observation: Observation, gate: float) -> Outcome:
        """Fuse a measurement whose NIS is at most `gate`.

        Above the gate, or where the NIS is nan because the result would not be positive definite, the state is left
        alone; a negative gate leaves it alone in any case.
        """
