"""The iterated filter at a bad start: 60 deg of heading and 100 m of position, against the filter without iterations.

Both get the same GNSS fixes and the Earth's field along the body's axes, from a simulated flight. A position is
linear in the state, and iterating it changes nothing; the field is not.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity, magnetometer
from mavins.examples import drawing
from mavins.examples.base import Figure
from mavins.examples.scenarios import origin_of
from mavins.filters import Filter, FilterState, ImuNoise, RowBlock, make
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import B_A, B_G, P_N, THETA_B, V_N, X_P, X_Q, X_SIZE, X_V
from mavins.nav.so3 import euler_to_quat, quat_mul, quat_to_dcm, quat_to_euler, wrap_pi
from mavins.types import FloatArray
from sitl.scenario import Scenario, load
from sitl.simulation import Measurements, simulate

FILTERS: Final = ("eskf", "ieskf")
SEEDS: Final = range(50)
IMU_RATE: Final = 100
BEGIN: Final = 20.0
"""s into the flight: the vehicle is in the air and on its way."""
DURATION: Final = 25.0
HEADING_ERROR: Final = math.radians(60.0)
POSITION_ERROR: Final = 100.0
"""Of the start, and its 1-sigma."""
SIGMA_V: Final = 0.5
SIGMA_TILT: Final = math.radians(1.0)
FIELD_RATE: Final = 10
FIELD_SIGMA: Final = 0.02
FIELD_N: Final = np.array([math.cos(math.radians(63.0)), 0.0, math.sin(math.radians(63.0))])
"""The field's direction in central Europe but for the declination."""
CLOSE: Final = (math.radians(3.0), 3.0)
"""Heading (rad) and position (m) errors below which a run has converged, if they stay there to its end."""


def start(m: Measurements, k: int, scenario: Scenario, rng: np.random.Generator) -> FilterState:
    """The truth at row k of the IMU, but for the errors, with a covariance that they match."""
    truth, imu = m.truth, scenario.imu
    x = np.zeros(X_SIZE)
    away = rng.uniform(0.0, 2.0 * math.pi)
    x[X_P] = truth.p_n[k] + POSITION_ERROR * np.array([math.cos(away), math.sin(away), 0.0])
    x[X_V] = truth.v_n[k] + SIGMA_V * rng.standard_normal(3)
    roll, pitch = SIGMA_TILT * rng.standard_normal(2)
    wrong = euler_to_quat(roll, pitch, HEADING_ERROR * rng.choice([-1.0, 1.0]))
    x[X_Q] = quat_mul(wrong, truth.q_nb[k])
    C = quat_to_dcm(x[X_Q])
    P = np.zeros((15, 15))
    P[P_N, P_N] = np.eye(3) * POSITION_ERROR**2
    P[V_N, V_N] = np.eye(3) * SIGMA_V**2
    P[THETA_B, THETA_B] = C.T @ np.diag([SIGMA_TILT, SIGMA_TILT, HEADING_ERROR]) ** 2 @ C
    P[B_G, B_G] = np.eye(3) * imu.gyro.bias**2
    P[B_A, B_A] = np.eye(3) * imu.accel.bias**2
    u = np.concatenate([m.imu.gyro_b[k], m.imu.accel_b[k]])
    return FilterState(x, P, u, int(m.imu.t_us[k]))


def measured(
    m: Measurements, k: int, scenario: Scenario, frame: TangentFrame, rng: np.random.Generator
) -> Iterator[Measurement]:
    """Position, velocity and field from row k of the IMU on, by their times."""
    g = scenario.gnss
    fixes = {fix.t_us: fix for fix in m.fixes}
    for i in range(k + 1, len(m.imu)):
        t_us = int(m.imu.t_us[i])
        if fix := fixes.get(t_us):
            yield gnss_position.measure(fix, t_us, frame, g.sigma_h, g.sigma_v, math.inf)
            velocity = gnss_velocity.measure(fix, t_us, frame, g.sigma_speed, math.inf)
            assert velocity is not None
            yield velocity
        if (i - k) % (IMU_RATE // FIELD_RATE) == 0:
            field_b = quat_to_dcm(m.truth.q_nb[i]).T @ FIELD_N
            field_b += FIELD_SIGMA * rng.standard_normal(3)
            yield magnetometer.measure("mag", t_us, t_us, field_b, FIELD_N, FIELD_SIGMA, math.inf)


def errors_of(
    algorithm: Filter,
    m: Measurements,
    state: FilterState,
    k: int,
    frame: TangentFrame,
    measurements: Sequence[Measurement],
) -> FloatArray:
    """Rows of s since the start, heading error (rad) and position error (m), after each measurement."""
    algorithm.adopt(state)
    imu = np.hstack([m.imu.gyro_b, m.imu.accel_b])
    began, rows, out = state.t_us, RowBlock.empty(1), []
    for measurement in measurements:
        t_us = measurement.t_us
        end = int(m.imu.t_us.searchsorted(t_us, "right"))
        if t_us > state.t_us:
            part, before = slice(k + 1, end), int(m.imu.t_us[k])
            algorithm.walk(state, frame, m.imu.t_us[part], imu[part], t_us, before, -1, rows)
            k = end - 1
        algorithm.update(state, measurement, math.inf)
        yaw, true_yaw = (quat_to_euler(q)[2] for q in (state.x[X_Q], m.truth.q_nb[k]))
        away = float(np.linalg.norm(state.x[X_P] - m.truth.p_n[k]))
        out.append(((t_us - began) * 1e-6, abs(wrap_pi(yaw - true_yaw)), away))
    return np.array(out)


def converged_after(errors: FloatArray) -> float:
    """Seconds until heading and position are close and stay so to the end; infinite where they never do."""
    far = np.flatnonzero((errors[:, 1] >= CLOSE[0]) | (errors[:, 2] >= CLOSE[1]))
    if not len(far):
        return float(errors[0, 0])
    return float(errors[far[-1] + 1, 0]) if far[-1] + 1 < len(errors) else math.inf


def fly(scenario: Scenario, seed: int) -> dict[str, FloatArray]:
    """One seed: errors_of each filter, on the same measurements from the same start."""
    m = simulate(scenario, seed, BEGIN + DURATION)
    frame = TangentFrame.at(origin_of(scenario))
    gyro, accel = scenario.imu.gyro, scenario.imu.accel
    noise = ImuNoise(gyro.noise, accel.noise, gyro.bias_walk, accel.bias_walk)
    rng = np.random.default_rng(seed)
    k = round(BEGIN * IMU_RATE)
    state = start(m, k, scenario, rng)
    measurements = list(measured(m, k, scenario, frame, rng))
    return {
        name: errors_of(make(name, noise), m, state.copy(), k, frame, measurements)
        for name in FILTERS
    }


def flown() -> Scenario:
    """The quadrotor's mission with a slower IMU."""
    scenario = load("quad_mission")
    imu = dataclasses.replace(scenario.imu, rate=IMU_RATE)
    return dataclasses.replace(scenario, imu=imu, truth_rate=1)


def run(data: Path | None, out: Path | None, say: Callable[[str], None]) -> Sequence[Figure]:
    """Fifty seeds through both filters."""
    scenario = flown()
    flights = [fly(scenario, seed) for seed in SEEDS]
    seconds = {
        name: np.array([converged_after(flight[name]) for flight in flights]) for name in FILTERS
    }
    say(f"a start off by 60 deg and 100 m, {len(flights)} seeds: s until within 3 deg and 3 m")
    say(f"{'':<8}{'10 %':>8}{'median':>8}{'90 %':>8}{'never':>8}")
    for name, values in seconds.items():
        low, median, high = np.quantile(values, [0.1, 0.5, 0.9], method="inverted_cdf")
        never = np.count_nonzero(np.isinf(values))
        say(f"{name:<8}{low:8.1f}{median:8.1f}{high:8.1f}{never:8d}")
    plain, iterated = (seconds[name] for name in FILTERS)
    sooner, later = (np.count_nonzero(x) for x in (iterated < plain, iterated > plain))
    say(f"ieskf is there sooner in {sooner} of {len(flights)} seeds, later in {later}")
    if out is not None and (plot := drawing.pyplot(say)) is not None:
        draw(plot, out / "iterated.png", flights)
    return [
        Figure(
            "median time of ieskf over that of eskf",
            float(np.median(iterated) / np.median(plain)),
            1.0,
        ),
        Figure("seeds in which ieskf never converges", float(np.isinf(iterated).sum()), 0.0),
    ]


def draw(plot: Any, path: Path, flights: Sequence[dict[str, FloatArray]]) -> None:
    """A picture of both errors over time: the median of all seeds, and the band of eight in ten."""
    figure, axes = plot.subplots(2, 1, sharex=True, figsize=(8.0, 6.0), layout="tight")
    for name in FILTERS:
        errors = np.array([flight[name] for flight in flights])
        t = errors[0, :, 0]
        for axis, column, scale in zip(axes, (1, 2), (math.degrees(1.0), 1.0), strict=True):
            low, median, high = scale * np.quantile(errors[:, :, column], [0.1, 0.5, 0.9], axis=0)
            axis.plot(t, median, label=name)
            axis.fill_between(t, low, high, alpha=0.2)
    for axis, label, limit in zip(
        axes, ("heading deg", "position m"), (math.degrees(CLOSE[0]), CLOSE[1]), strict=True
    ):
        axis.axhline(limit, color="k", linewidth=0.8, linestyle="--")
        axis.set(yscale="log", ylabel=label)
    axes[0].legend()
    axes[1].set_xlabel("s since the start")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plot.close(figure)
