"""RMS errors over Barton's square spiral, 10 seeds, beside those of his filter (10 seeds)."""

from __future__ import annotations

import math

import numpy as np

from mavins.estimator.settings import (
    GnssSettings,
    HeadingSettings,
    ImuSettings,
    Settings,
    StatesSettings,
)
from mavins.evaluation.montecarlo import estimate
from mavins.nav.so3 import quat_to_euler, wrap_pi
from mavins.types import FloatArray, Origin
from sitl.scenario import Scenario, load
from sitl.simulation import simulate

SEEDS = 10
DURATION = 418.0
"""Standing, the run-up and the record's 400 s; the way back to the start is ours and not judged."""
SETTLED_US = 60_000_000
BARTON = (0.62, 0.60, 0.24, 0.058, 0.057, 0.034, 0.345, 0.433, 0.668)
COLUMNS = ("N m", "E m", "h m", "vN m/s", "vE m/s", "vD m/s", "roll deg", "pitch deg", "yaw deg")


def settings_of(scenario: Scenario) -> Settings:
    """The filter is told the noises of the sensors, as Barton's is."""
    gyro, accel = scenario.imu.gyro, scenario.imu.accel
    return Settings(
        imu=ImuSettings(
            gyro_noise=gyro.noise,
            accel_noise=accel.noise,
            gyro_bias_walk=1e-6,
            accel_bias_walk=1e-5,
            gyro_bias_sigma=gyro.bias,
            accel_bias_sigma=accel.bias,
        ),
        gnss=GnssSettings(delay=0.0, position_floor=0.01, velocity_floor=0.01),
        heading=HeadingSettings(sigma_deg=scenario.heading.sigma_deg),
        states=StatesSettings(gnss_delay="fixed"),
    )


def errors_of(scenario: Scenario, seed: int) -> FloatArray:
    """Errors (N, 9) at every IMU sample from 60 s of the record on, in the units of COLUMNS."""
    o = scenario.origin
    origin = Origin(math.radians(o.lat_deg), math.radians(o.lon_deg), o.alt)
    m = simulate(scenario, seed, DURATION)
    run = estimate(settings_of(scenario), origin, m.imu, m.fixes, m.headings, 0)
    begin = int(m.imu.t_us[0]) + round((6.0 + 12.0) * 1e6) + SETTLED_US
    late = run.t_us >= begin
    k = np.searchsorted(m.truth.t_us, run.t_us[late])
    x = run.x[late]
    e = np.empty((len(k), 9))
    e[:, 0:3] = x[:, 0:3] - m.truth.p_n[k]
    e[:, 3:6] = x[:, 3:6] - m.truth.v_n[k]
    for i, row in enumerate(k):
        angles = quat_to_euler(x[i, 6:10]) - quat_to_euler(m.truth.q_nb[row])
        e[i, 6:9] = [math.degrees(wrap_pi(a)) for a in angles]
    return e


def main() -> None:
    scenario = load("square_spiral")
    squares = [np.mean(errors_of(scenario, seed) ** 2, axis=0) for seed in range(SEEDS)]
    rms = np.sqrt(np.mean(squares, axis=0))
    print(f"square_spiral, {SEEDS} seeds, RMS after 60 s")
    print(f"{'':10s}{'mavins':>9s}{'Barton':>9s}")
    for name, ours, his in zip(COLUMNS, rms, BARTON, strict=True):
        print(f"{name:10s}{ours:9.4f}{his:9.3f}  {'' if ours <= his else 'worse'}")


if __name__ == "__main__":
    main()
