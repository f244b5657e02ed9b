"""A solution far from its origin with a random covariance, the filter's state behind it, and pymavlink's view."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.estimator.solution import solution_of
from mavins.filters import FilterState
from mavins.mavlink.codec import Payload, frame
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, X_SIZE, Layout
from mavins.nav.so3 import euler_to_quat, quat_exp, quat_mul
from mavins.types import FloatArray, Health, NavSolution, Origin

FRAME = TangentFrame.at(Origin(math.radians(60.0), math.radians(8.0), 300.0))
LAYOUT = Layout.of(CORE)


def solution_at(error: FloatArray | None = None, health: Health = Health.RUNNING) -> NavSolution:
    """300 km from the origin, where n and l differ by 5 degrees; off by an error state (15,)."""
    rng = np.random.default_rng(5)
    x, u = np.zeros(X_SIZE), np.zeros(6)
    x[0:3] = (2.0e5, 2.2e5, -900.0)
    x[3:6] = (12.0, -7.0, 2.0)
    x[6:10] = euler_to_quat(0.3, -0.4, 2.0)
    x[10:13], x[13:16] = (0.01, -0.02, 0.005), (0.1, 0.2, -0.05)
    u[0:3], u[3:6] = (0.1, -0.2, 0.3), (0.5, 1.5, -9.0)
    if error is not None:
        x[0:6] += error[0:6]
        x[6:10] = quat_mul(x[6:10], quat_exp(error[6:9]))
        x[10:16] += error[9:15]
    scale = np.repeat([2.0, 0.3, 0.02, 0.001, 0.05], 3)
    root = rng.normal(size=(15, 15)) * scale[:, np.newaxis]
    state = FilterState(x, root @ root.T, u, 12_345_678)
    return solution_of(state, LAYOUT, FRAME, health, 259)


@pytest.fixture
def tangent() -> TangentFrame:
    return FRAME


@pytest.fixture
def far() -> Callable[..., NavSolution]:
    return solution_at


@pytest.fixture
def transferred() -> Callable[[Callable[[NavSolution], FloatArray]], FloatArray]:
    """J P J^T of a function of the solution, J by central differences in the error state."""

    def transfer(quantity: Callable[[NavSolution], FloatArray]) -> FloatArray:
        columns = []
        for k in range(15):
            step = np.zeros(15)
            step[k] = 1e-4 if k < 6 else 1e-6
            difference = quantity(solution_at(step)) - quantity(solution_at(-step))
            columns.append(difference / (2.0 * step[k]))
        jacobian = np.array(columns).T
        return np.asarray(jacobian @ solution_at().P @ jacobian.T)

    return transfer


@pytest.fixture
def by_pymavlink() -> Callable[[Payload], Any]:
    def decoded(payload: Payload) -> Any:
        return dialect.MAVLink(None).decode(bytearray(frame(payload, 7, 1, 3)))

    return decoded
