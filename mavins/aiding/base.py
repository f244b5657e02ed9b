"""What an aiding model is: a residual, its Jacobian over the canonical errors, and a noise covariance."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from mavins.types import FloatArray

Model: TypeAlias = Callable[
    [FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]
]
"""(x (20,), u (6,), z (m,), parameters) -> (residual z - h(x) (m,), H = d h / d canonical errors (m, 19))."""


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
