"""What an estimator said over time, as arrays with names: estimates, innovations, and a whole run of them."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from mavins.config import Config
from mavins.estimator.fusion import Event
from mavins.estimator.solution import (
    B_A,
    B_G,
    EULER,
    LLA,
    P_N,
    Q_LB,
    SD_EULER,
    SD_P,
    SD_V,
    V_L,
)
from mavins.evaluation.errors import Errors, errors_against
from mavins.logs.truth import Truth
from mavins.results import BIAS_SIGMAS
from mavins.types import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEAD: Final = 5
"""Numbers of a decision before its innovation: t_us, stamp_us, accepted, nis, rows."""
_ROWS: Final = 3
"""The most rows a measurement has."""


@dataclass(frozen=True, slots=True)
class Estimates:
    """N estimates at `t_us` (N,), in us on the vehicle's IMU clock.

    `table` (N, 37 + k) is what estimates.csv holds, in rad: the views below are into it. `further` says where the
    states beyond 15 are in it: name -> (values, sigmas).
    """

    t_us: IntArray
    table: FloatArray
    further: Mapping[str, tuple[slice, slice]]

    def __len__(self) -> int:
        return len(self.t_us)

    @property
    def seconds(self) -> FloatArray:
        """The instants (N,) in s."""
        return np.asarray(self.t_us * 1e-6, dtype=np.float64)

    @property
    def lla(self) -> FloatArray:
        """Latitude and longitude in rad, altitude in m above mean sea level (N, 3)."""
        return self.table[:, LLA]

    @property
    def p_n(self) -> FloatArray:
        """Position in frame n, from its origin, north, east, down (N, 3), m."""
        return self.table[:, P_N]

    @property
    def v(self) -> FloatArray:
        """Velocity in the local level frame, north, east, down (N, 3), m/s."""
        return self.table[:, V_L]

    @property
    def euler(self) -> FloatArray:
        """Roll, pitch, yaw (N, 3), rad, Z-Y-X in the local level frame."""
        return self.table[:, EULER]

    @property
    def quaternions(self) -> FloatArray:
        """Attitude, body to local level, scalar first (N, 4)."""
        return self.table[:, Q_LB]

    @property
    def sd_p_n(self) -> FloatArray:
        """1-sigma of `p_n` (N, 3), m."""
        return self.table[:, SD_P]

    @property
    def sd_v(self) -> FloatArray:
        """1-sigma of `v` (N, 3), m/s."""
        return self.table[:, SD_V]

    @property
    def sd_euler(self) -> FloatArray:
        """1-sigma of `euler` (N, 3), rad."""
        return self.table[:, SD_EULER]

    @property
    def b_g(self) -> FloatArray:
        """Gyro bias, body (N, 3), rad/s."""
        return self.table[:, B_G]

    @property
    def b_a(self) -> FloatArray:
        """Accelerometer bias, body (N, 3), m/s^2."""
        return self.table[:, B_A]

    @property
    def sd_b_g(self) -> FloatArray:
        """1-sigma of `b_g` (N, 3), rad/s."""
        return self.table[:, BIAS_SIGMAS][:, :3]

    @property
    def sd_b_a(self) -> FloatArray:
        """1-sigma of `b_a` (N, 3), m/s^2."""
        return self.table[:, BIAS_SIGMAS][:, 3:]

    def state(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Values and 1-sigmas (N, m) of a further state: l_b, tau, b_baro, b_m or g_n; KeyError where it is not one."""
        values, sigmas = self.further[name]
        return self.table[:, values], self.table[:, sigmas]

    def against(self, truth: Truth) -> Errors:
        """Errors at those instants that the truth covers."""
        return errors_against(self.t_us, self.lla, self.v, self.euler, truth.columns())


@dataclass(frozen=True, slots=True)
class Innovations:
    """The final decisions on N measurements of one aiding, in the order in which they were made.

    `t_us` when each was valid, `stamp_us` its stamp; `accepted` (N,) and, where it was not, `reason` (N,); `nis` (N,);
    `innovation` and `sigma` (N, m) of its m rows, measured minus predicted. What is not known is nan.
    """

    t_us: IntArray
    stamp_us: IntArray
    source: NDArray[np.str_]
    accepted: NDArray[np.bool_]
    reason: NDArray[np.str_]
    nis: FloatArray
    innovation: FloatArray
    sigma: FloatArray

    def __len__(self) -> int:
        return len(self.t_us)

    @property
    def rows(self) -> int:
        """How many rows a measurement has."""
        return int(self.innovation.shape[1])


@dataclass(frozen=True, slots=True)
class Result(Estimates):
    """A run of the estimator over a log.

    `innovations` by aiding. `errors` are those against the truth, or for want of one the differences to the log's own
    filter (`reference`); None where the log has neither. `smoothed` where it was asked for. `summary` is what
    summary.json holds, and `config` the configuration with all that the log itself decided.
    """

    config: Config
    innovations: Mapping[str, Innovations]
    truth: Truth | None
    reference: Truth | None
    errors: Errors | None
    smoothed: Estimates | None
    summary: Mapping[str, Any]

    def plot(self) -> Figure:
        """Draw it as a matplotlib figure, which needs the extra `report`."""
        try:
            from mavins.result_plot import plot_result
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] != "matplotlib":
                raise
            hint = "matplotlib is not installed; install it with: pip install 'mavins[report]'"
            raise ModuleNotFoundError(hint, name=error.name) from error
        return plot_result(self)


class Decisions:
    """Keeps decisions in few bytes until they are asked for."""

    def __init__(self) -> None:
        self._numbers: dict[str, array[float]] = {}
        self._words: dict[str, list[tuple[str, str]]] = {}

    def keep(self, event: Event) -> None:
        """Keep a decision."""
        m = event.measurement
        if m.aiding not in self._numbers:
            self._numbers[m.aiding], self._words[m.aiding] = array("d"), []
        r, sigma = event.innovation.tolist(), event.sigma.tolist()
        lack = [np.nan] * (_ROWS - len(r))
        head = (m.t_us, m.stamp_us, event.accepted, event.nis, len(r))
        self._numbers[m.aiding].extend((*head, *r, *lack, *sigma, *lack))
        self._words[m.aiding].append((m.source, event.reason))

    def by_aiding(self) -> dict[str, Innovations]:
        """All that was kept, as arrays."""
        return {name: self._of(name) for name in sorted(self._numbers)}

    def _of(self, aiding: str) -> Innovations:
        n = np.array(self._numbers[aiding]).reshape(-1, _HEAD + 2 * _ROWS)
        source, reason = zip(*self._words[aiding], strict=True)
        rows = max(1, int(n[:, 4].max()))
        return Innovations(
            n[:, 0].astype(np.int64),
            n[:, 1].astype(np.int64),
            np.array(source),
            n[:, 2].astype(np.bool_),
            np.array(reason),
            n[:, 3],
            n[:, _HEAD : _HEAD + rows],
            n[:, _HEAD + _ROWS : _HEAD + _ROWS + rows],
        )
