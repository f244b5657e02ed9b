"""What an aiding model is: a residual, its Jacobian over the canonical errors, and a noise covariance."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from mavins.types import FloatArray

Model: TypeAlias = Callable[
    [FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]
]
"""(x (26,), u (6,), z (m,), parameters) -> (residual z - h(x) (m,), H = d h / d canonical errors (m, 25))."""


class Measurement(NamedTuple):
    """One measurement, ready to be fused at its own valid time.

    `z` (m,) with noise `R` (m, m); `model` gives residual and Jacobian, with `parameters` for what it needs
    beside the state. `rank` orders measurements of one instant, `gate` is in sigmas; `quality` is the reason
    not to use it, if any.
    """

    aiding: str
    rank: int
    source: str
    stamp_us: int
    t_us: int
    z: FloatArray
    R: FloatArray
    parameters: FloatArray
    model: Model
    gate: float
    quality: str = ""

    def linearize(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(r (m,), H (m, 25)) at a nominal state x (26,) with the IMU reading u (6,)."""
        return self.model(x, u, self.z, self.parameters)

    def residuals(self, X: FloatArray, u: FloatArray) -> FloatArray:
        """The residuals (k, m) of nominal states X (k, 26)."""
        from mavins.aiding.many import (
            residuals,
        )  # it knows every aiding, and each of them this file

        out: FloatArray = residuals(self.rank, X, u, self.z, self.parameters)
        return out

    def differences(self, X: FloatArray, u: FloatArray, r: FloatArray) -> FloatArray:
        """The residuals (k, m) of X less the residual r (m,): the short way round where residuals are wrapped."""
        return self._replace(z=self.z - r).residuals(X, u)
