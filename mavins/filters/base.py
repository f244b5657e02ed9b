"""What the estimator asks of every filter, and the state that a filter works on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mavins.nav.earth import TangentFrame
from mavins.nav.layout import Layout
from mavins.types import FloatArray, IntArray


@dataclass(slots=True)
class FilterState:
    """A filter's whole memory: nominal `x` (20,), covariance `P` (n, n), last IMU reading `u` (6,), time `t_us`.

    `u` is [gyro_b (3), accel_b (3)] as read, not bias-corrected, valid at t_us. Filters change the arrays in place.
    """

    x: FloatArray
    P: FloatArray
    u: FloatArray
    t_us: int

    def copy(self) -> FilterState:
        """A copy that shares nothing with this one."""
        return FilterState(self.x.copy(), self.P.copy(), self.u.copy(), self.t_us)


@dataclass(slots=True)
class RowBlock:
    """Estimates at consecutive instants, of which the first `count` are filled.

    t_us (N,), x (N, 20), u (N, 6), P (N, 15, 15).
    """

    t_us: IntArray
    x: FloatArray
    u: FloatArray
    P: FloatArray
    count: int = 0

    @classmethod
    def empty(cls, capacity: int) -> RowBlock:
        """A block with room for `capacity` rows."""
        return cls(
            np.empty(capacity, dtype=np.int64),
            np.empty((capacity, 20)),
            np.empty((capacity, 6)),
            np.empty((capacity, 15, 15)),
        )


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Root PSDs of the IMU's errors: gyro rad/s/sqrt(Hz), accel m/s^2/sqrt(Hz), and the walks of their biases."""

    gyro: float
    accel: float
    gyro_bias_walk: float
    accel_bias_walk: float

    def as_array(self) -> FloatArray:
        """The (4,) array that the kernels take."""
        return np.array([self.gyro, self.accel, self.gyro_bias_walk, self.accel_bias_walk])


class Filter(Protocol):
    """A navigation filter over a `Layout` of error states."""

    layout: Layout

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
    ) -> None:
        """Move `state` through IMU rows: stamps `t_us` (N,), readings `imu` (N, 6) as in FilterState.u.

        All rows up to `until_us` are walked; if the last row lies beyond it, the state goes on to that instant,
        with the reading on the line to that row.

        A row is appended to `rows` for the first stamp at or after each multiple of `grid_us` (every stamp if 0,
        none if negative); `previous_us` is the stamp of the IMU row before the first.
        """

    def update(
        self,
        state: FilterState,
        r: FloatArray,
        H: FloatArray,
        R: FloatArray,
        gate: float,
        sigma: FloatArray,
    ) -> float:
        """Fuse residual r (m,) with its Jacobian over the canonical errors H (m, 19) and noise R (m, m).

        Returns the NIS and writes sqrt(diag(H P H^T + R)) to `sigma` (m,). Above `gate`, or nan where the result would
        not be positive definite, the state was left alone; a negative gate leaves it alone in any case.
        """
