"""Microseconds per IMU sample in the walk of every registered filter, beside a calibration loop of plain arithmetic.

A figure is the best of many rounds; the walk is the compiled loop that live and replay share. The ratio to the
calibration loop says how much of a change is the machine's.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numba
import numpy as np

from mavins.filters import REGISTRY, Filter, FilterSettings, FilterState, ImuNoise, RowBlock, make
from mavins.filters.settings import SrcdkfSettings
from mavins.nav.earth import TangentFrame, gravity_n
from mavins.nav.layout import X_SIZE
from mavins.types import FloatArray, IntArray, Origin

SAMPLES = 100
STEP_US = 4000
ROUNDS = 1000
NOISE = ImuNoise(0.015, 0.35, 1e-4, 3e-3)
VARIANTS = {
    "srcdkf full": ("srcdkf", FilterSettings(srcdkf=SrcdkfSettings(full=True))),
}
"""Forms of a filter that are not its default."""
TARGETS = {
    "eskf": 1.5,
    "euler_ekf": 3.0,
    "ieskf": 2.0,
    "iekf": 2.0,
    "srcdkf": 10.0,
    "srcdkf full": 16.0,
}


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


def best(run: Callable[[], object], n: int) -> float:
    """Microseconds a turn: the best of many short runs, so that another process on the core is seen through."""
    run()
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times) / n * 1e6


def walker(
    algorithm: Filter, start: FilterState, frame: TangentFrame, t_us: IntArray, imu: FloatArray
) -> Callable[[], None]:
    """A walk over all samples, always from the same start."""
    rows = RowBlock.empty(1)

    def walk() -> None:
        state = start.copy()
        algorithm.walk(state, frame, t_us, imu, int(t_us[-1]), 0, -1, rows)

    return walk


def main() -> None:
    frame = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 488.0))
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    prior = np.repeat([1.0, 0.3, 0.05, 0.01, 0.2], 3) ** 2
    imu = np.random.default_rng(1).normal(size=(SAMPLES, 6)) * np.repeat([0.05, 0.5], 3)
    imu[:, 3:] -= gravity_n(np.zeros(3), frame.r0_e, frame.C_ne)
    t_us = STEP_US * np.arange(1, SAMPLES + 1)
    forms = {name: (name, FilterSettings()) for name in REGISTRY} | VARIANTS
    unit = best(lambda: calibration(SAMPLES), SAMPLES)
    print(f"{'':14s}{'us':>8s}{'target':>8s}{'x calibration':>15s}")
    print(f"{'calibration':14s}{unit:8.3f}{'':8s}{1.0:15.2f}")
    for form, (name, settings) in forms.items():
        algorithm = make(name, NOISE, settings=settings)
        start = FilterState(x.copy(), np.diag(prior), imu[0].copy(), 0)
        algorithm.adopt(start)
        value = best(walker(algorithm, start, frame, t_us, imu), SAMPLES)
        target = f"{TARGETS[form]:8.1f}" if form in TARGETS else " " * 8
        print(f"{form:14s}{value:8.3f}{target}{value / unit:15.2f}")


if __name__ == "__main__":
    main()
