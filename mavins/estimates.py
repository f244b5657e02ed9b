"""What an estimator said over time, as arrays with names: estimates, innovations, and a whole run of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mavins.config import Config
from mavins.estimator.solution import EULER, LLA, P_N, Q_LB, V_L
from mavins.evaluation.errors import Errors, errors_against
from mavins.evaluation.evidence import Evidence
from mavins.logs.truth import Truth, judge_of
from mavins.nav.layout import Layout
from mavins.results import places
from mavins.types import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Estimates:
    """N estimates at `t_us` (N,), in us on the vehicle's IMU clock.

    `table` (N, 37 + k) is what estimates.csv holds, in rad, and then the sigmas of the biases, nan where they were not
    kept; the views below are into it. `layout` says which states are estimated.
    """

    t_us: IntArray
    table: FloatArray
    layout: Layout

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
        return self.state("p_n")[1]

    @property
    def sd_v(self) -> FloatArray:
        """1-sigma of `v` (N, 3), m/s."""
        return self.state("v")[1]

    @property
    def sd_euler(self) -> FloatArray:
        """1-sigma of `euler` (N, 3), rad."""
        return self.state("euler")[1]

    @property
    def b_g(self) -> FloatArray:
        """Gyro bias, body (N, 3), rad/s."""
        return self.state("b_g")[0]

    @property
    def b_a(self) -> FloatArray:
        """Accelerometer bias, body (N, 3), m/s^2."""
        return self.state("b_a")[0]

    @property
    def sd_b_g(self) -> FloatArray:
        """1-sigma of `b_g` (N, 3), rad/s."""
        return self.state("b_g")[1]

    @property
    def sd_b_a(self) -> FloatArray:
        """1-sigma of `b_a` (N, 3), m/s^2."""
        return self.state("b_a")[1]

    def state(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Values and 1-sigmas (N, m) of p_n, v, euler, b_g, b_a, and where it is estimated of l_b, tau, b_baro, b_m or
        g_n; KeyError for any other."""
        values, sigmas = places(self.layout)[name]
        return self.table[:, values], self.table[:, sigmas]

    def has(self, name: str) -> bool:
        """True where `state` tells it."""
        return name in places(self.layout)

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

    def select(self, which: NDArray[Any]) -> Innovations:
        """The decisions with these numbers, or where this is true."""
        return Innovations(*(getattr(self, column.name)[which] for column in fields(self)))


def by_aiding(decisions: Mapping[str, NDArray[Any]]) -> dict[str, Innovations]:
    """The columns of decisions on all aidings together, three of each innovation and sigma, as each aiding's own."""
    found, aiding = {}, decisions["aiding"]
    for name in dict.fromkeys(aiding.tolist()):
        part = Innovations(*(decisions[column.name] for column in fields(Innovations)))
        part = part.select(aiding == name)
        rows = max(1, int(np.isfinite(part.innovation).any(axis=0).sum()))
        found[name] = replace(
            part, innovation=part.innovation[:, :rows], sigma=part.sigma[:, :rows]
        )
    return found


@dataclass(frozen=True, slots=True)
class Result(Estimates):
    """A run of the estimator over a log, as `mavins.run` makes it or `read_result` finds it in a folder.

    `innovations` by aiding. `evidence` is what the log held, None where none was kept, as by a live service. `errors`
    are those against `judge`, None where it covers nothing. `smoothed` where it was asked for. `summary` is what
    summary.json holds, and `config` the configuration with all that the log itself decided.
    """

    config: Config
    innovations: Mapping[str, Innovations]
    evidence: Evidence | None
    errors: Errors | None
    smoothed: Estimates | None
    summary: Mapping[str, Any]

    @property
    def filter(self) -> str:
        """Whose result it is."""
        return self.config.filter

    @property
    def truth(self) -> Truth | None:
        """What a simulator, or a reference.csv, knew."""
        return None if self.evidence is None else self.evidence.truth

    @property
    def reference(self) -> Truth | None:
        """What the log's own filter said."""
        return None if self.evidence is None else self.evidence.reference

    @property
    def judge(self) -> Truth | None:
        """What the estimates are measured against: the truth, or for want of one the log's own filter."""
        return judge_of(self.truth, self.reference)

    @property
    def is_true(self) -> bool:
        """True where `judge` is a truth."""
        return self.judge is not None and self.judge is self.truth

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
