"""Times of the hot kernels in compiled loops, and beside them a calibration loop of plain arithmetic.

A figure is the best of many rounds. The ratio to the calibration loop says how much of a change is the machine's.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numba
import numpy as np

from mavins.filters.base import ImuNoise
from mavins.filters.eskf import fuse
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.ins import increments_from_rates, predict, workspace
from mavins.nav.layout import CANONICAL_SIZE, X_SIZE, Layout
from mavins.types import FloatArray, IntArray, Origin

LOOPS = 500
ROUNDS = 1000
TARGETS = {"predict": 1.5, "6-row update": 3.0}


@numba.njit
def calibration(n: int) -> float:
    """100 dependent multiplications and additions a round."""
    total = 0.0
    x = 1.0
    for _ in range(n):
        for i in range(100):
            x = x * 0.999999 + 1e-6 * i
        total += x
    return total


@numba.njit
def predictions(
    n: int,
    x: FloatArray,
    P: FloatArray,
    imu: FloatArray,
    noise: FloatArray,
    r0_e: FloatArray,
    C_ne: FloatArray,
    w_ie_n: FloatArray,
) -> None:
    work = workspace(P.shape[0], False)
    for k in range(n):
        a, b = imu[k % 100], imu[(k + 1) % 100]
        phi, dv = increments_from_rates(
            (a[0], a[1], a[2]), (a[3], a[4], a[5]), (b[0], b[1], b[2]), (b[3], b[4], b[5]), 0.004
        )
        predict(x, P, phi, dv, 0.004, noise, 1.0, r0_e, C_ne, w_ie_n, work)


@numba.njit
def updates(
    n: int,
    x: FloatArray,
    P: FloatArray,
    prior: FloatArray,
    H: FloatArray,
    R: FloatArray,
    columns: IntArray,
    gate: float,
) -> float:
    """Position and velocity at once: six rows, gated, fed back and reset."""
    residuals = 0.01 * (np.arange(48.0).reshape(8, 6) % 7.0 - 3.0)
    S = np.empty((6, 6))
    total = 0.0
    for k in range(n):
        if k % 50 == 0:
            P[:, :] = prior
        total += fuse(x, P, residuals[k & 7], H, R, columns, gate, S)
    return total


def best(run: Callable[[], object], n: int) -> float:
    """Microseconds a call: the best of many short runs, so that another process on the core is seen through."""
    run()
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times) / n * 1e6


def main() -> None:
    frame = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
    earth = (frame.r0_e, frame.C_ne, frame.w_ie_n)
    rng = np.random.default_rng(1)
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    prior = np.diag(np.repeat([1.0, 0.3, 0.05, 0.01, 0.2], 3) ** 2)
    imu = rng.normal(size=(100, 6)) * np.repeat([0.05, 0.5], 3)
    imu[:, 3:] -= gravity_n(np.zeros(3), frame.r0_e, frame.C_ne)
    noise = ImuNoise(0.015, 0.35, 1e-4, 3e-3).as_array(Layout.of())
    H = np.zeros((6, CANONICAL_SIZE))
    H[:3, :3] = H[3:, 3:6] = np.eye(3)
    H[:3, 6:9] = H[3:, 6:9] = 0.1 * rng.normal(size=(3, 3))
    H[3:, 9:12] = 0.1 * rng.normal(size=(3, 3))
    R = np.diag([0.25, 0.25, 0.64, 0.09, 0.09, 0.09])
    columns = Layout.of().columns

    def predict_all() -> None:
        predictions(LOOPS, x.copy(), prior.copy(), imu, noise, *earth)

    def update_all() -> float:
        return updates(LOOPS, x.copy(), prior.copy(), prior, H, R, columns, 100.0)

    unit = best(lambda: calibration(LOOPS), LOOPS)
    figures = {"predict": best(predict_all, LOOPS), "6-row update": best(update_all, LOOPS)}
    print(f"{'':14s}{'us':>8s}{'target':>8s}{'x calibration':>15s}")
    print(f"{'calibration':14s}{unit:8.3f}{'':8s}{1.0:15.2f}")
    for name, value in figures.items():
        print(f"{name:14s}{value:8.3f}{TARGETS[name]:8.1f}{value / unit:15.2f}")


if __name__ == "__main__":
    main()
