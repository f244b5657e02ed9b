"""RMS errors over Barton's square spiral, 10 seeds, beside those of his filter (10 seeds)."""

from __future__ import annotations

import dataclasses

import numpy as np

from mavins.config import Config
from mavins.evaluation.compare import run
from mavins.examples.scenarios import flight, matched
from mavins.types import FloatArray
from sitl.scenario import Scenario, load
from sitl.simulation import START_US

SEEDS = 10
DURATION = 418.0
"""Standing, the run-up and the record's 400 s; the way back to the start is ours and not judged."""
SETTLED_US = 60_000_000
BARTON = (0.62, 0.60, 0.24, 0.058, 0.057, 0.034, 0.345, 0.433, 0.668)
COLUMNS = ("N m", "E m", "h m", "vN m/s", "vE m/s", "vD m/s", "roll deg", "pitch deg", "yaw deg")


def config_of(scenario: Scenario) -> Config:
    """The filter is told the noises of the sensors, as Barton's is."""
    config = matched(Config(), scenario)
    imu = dataclasses.replace(config.imu, gyro_bias_walk=1e-6, accel_bias_walk=1e-5)
    gnss = dataclasses.replace(config.gnss, position_floor=0.01, velocity_floor=0.01)
    return dataclasses.replace(config, imu=imu, gnss=gnss)


def errors_of(scenario: Scenario, seed: int) -> FloatArray:
    """Errors (N, 9) at every IMU sample from 60 s of the record on, in the units of COLUMNS."""
    config = config_of(scenario)
    tape, truth = flight(config, scenario, seed, DURATION)
    errors = run(config.filter, config, tape, truth).errors
    assert errors is not None
    late = errors.t_us >= START_US + round((6.0 + 12.0) * 1e6) + SETTLED_US
    return np.hstack([errors.pos, errors.vel, np.degrees(errors.att)])[late]


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
