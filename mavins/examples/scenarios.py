"""Simulated flights for filters: what an estimator is fed, the truth, and the settings that match the sensors."""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Iterator

import numpy as np

from mavins.config import Config
from mavins.estimator.settings import StatesSettings
from mavins.evaluation.compare import Truth
from mavins.evaluation.tape import Tape
from mavins.types import GnssFix, HeadingFix, ImuTable, Origin
from sitl.scenario import Scenario
from sitl.simulation import simulate


def origin_of(scenario: Scenario) -> Origin:
    """The scenario's origin of frame n."""
    o = scenario.origin
    return Origin(math.radians(o.lat_deg), math.radians(o.lon_deg), o.alt)


def matched(config: Config, scenario: Scenario) -> Config:
    """The configuration with the scenario's noises, lever arm and latency: what a careful user would set."""
    gyro, accel = scenario.imu.gyro, scenario.imu.accel
    imu = dataclasses.replace(
        config.imu,
        gyro_noise=gyro.noise,
        accel_noise=accel.noise,
        gyro_bias_walk=gyro.bias_walk,
        accel_bias_walk=accel.bias_walk,
        gyro_bias_sigma=gyro.bias,
        accel_bias_sigma=accel.bias,
    )
    lever = scenario.gnss.lever_arm
    gnss = dataclasses.replace(
        config.gnss,
        delay=scenario.gnss.latency,
        lever_arm=(lever[0], lever[1], lever[2]),
        position_floor=1e-3,
        velocity_floor=1e-3,
    )
    heading = dataclasses.replace(config.heading, sigma_deg=scenario.heading.sigma_deg)
    states = StatesSettings(lever_arm="fixed", gnss_delay="fixed")
    return dataclasses.replace(config, imu=imu, gnss=gnss, heading=heading, states=states)


def flight(config: Config, scenario: Scenario, seed: int, duration: float) -> tuple[Tape, Truth]:
    """A scenario flown with a seed: measurements by their stamps (at one stamp IMU, heading, fix), and the truth."""
    m = simulate(dataclasses.replace(scenario, truth_rate=50), seed, duration)
    tape = Tape(config)
    tape.set_origin(origin_of(scenario))
    start = 0
    aids: Iterator[GnssFix | HeadingFix] = heapq.merge(m.headings, m.fixes, key=lambda a: a.t_us)
    for aid in aids:
        end = int(m.imu.t_us.searchsorted(aid.t_us, "right"))
        if end > start:
            tape.feed_imu(_rows(m.imu, start, end))
            start = end
        if isinstance(aid, HeadingFix):
            tape.feed_heading(aid)
        else:
            tape.feed_gnss(dataclasses.replace(aid, delay=scenario.gnss.latency))
    if start < len(m.imu):
        tape.feed_imu(_rows(m.imu, start, len(m.imu)))
    samples = [state.sample for state in m.states]
    truth = Truth(
        np.array([s.t_us for s in samples]),
        np.array([(s.lat, s.lon, s.alt) for s in samples]),
        np.array([s.v_l for s in samples]),
        np.array([s.q_lb for s in samples]),
    )
    return tape, truth


def _rows(imu: ImuTable, start: int, end: int) -> ImuTable:
    return ImuTable(imu.t_us[start:end], imu.accel_b[start:end], imu.gyro_b[start:end])
