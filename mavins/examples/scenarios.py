"""Simulated flights for filters: what an estimator is fed, the truth, and the settings that match the sensors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading
from mavins.config import Config
from mavins.estimator.quality import noise_of
from mavins.estimator.settings import StatesSettings
from mavins.evaluation.course import Course
from mavins.evaluation.tape import Tape
from mavins.logs.truth import Truth
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_L, X_P, X_Q, X_SIZE, X_TAU, X_V
from mavins.nav.rotations import yaws_of
from mavins.types import FloatArray, GnssFix, HeadingFix, IntArray, Origin
from sitl.scenario import Scenario
from sitl.simulation import START_US, simulate

COURSE_STEP_US = 10_000
"""Between the samples of a true course."""


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
    """A scenario flown with a seed: measurements by their stamps (at one stamp IMU, heading, fix), and the truth.

    The fixes come with the configured delay, or where that is `auto` with the true one.
    """
    told = config.gnss.delay
    delay = scenario.gnss.latency if told == "auto" else told
    m = simulate(dataclasses.replace(scenario, truth_rate=50), seed, duration)
    tape = Tape(config)
    tape.set_origin(origin_of(scenario))
    start = 0
    aids: list[GnssFix | HeadingFix] = [*m.headings, *m.fixes]
    aids.sort(key=lambda aid: aid.t_us)
    ends = m.imu.t_us.searchsorted([aid.t_us for aid in aids], "right").tolist()
    for aid, end in zip(aids, ends, strict=True):
        if end > start:
            tape.feed_imu(m.imu[start:end])
            start = end
        if isinstance(aid, HeadingFix):
            tape.feed_heading(aid)
        else:
            tape.feed_gnss(dataclasses.replace(aid, delay=delay))
    if start < len(m.imu):
        tape.feed_imu(m.imu[start:])
    samples = [state.sample for state in m.states]
    truth = Truth(
        np.array([s.t_us for s in samples]),
        np.array([(s.lat, s.lon, s.alt) for s in samples]),
        np.array([s.v_l for s in samples]),
        np.array([s.q_lb for s in samples]),
    )
    return tape, truth


def course(config: Config, scenario: Scenario, duration: float) -> Course:
    """The true course of a scenario: states without errors, and GNSS and headings at the instants of their validity."""
    motion = scenario.trajectory()
    t_us = np.arange(0, round(duration * 1e6) + 1, COURSE_STEP_US, dtype=np.int64)
    k = motion.at(t_us.astype(np.float64) * 1e-6)
    x = np.zeros((len(t_us), X_SIZE))
    x[:, X_P], x[:, X_V], x[:, X_Q] = k.p_n, k.v_n, k.q_nb
    x[:, X_L] = scenario.gnss.lever_arm
    x[:, X_TAU] = scenario.gnss.latency
    u = np.column_stack(motion.inertial(k))
    lla, v_l, q_lb = motion.local_level(k)
    stamps = START_US + t_us
    at_fix = _every(t_us, scenario.gnss.rate)
    phase = np.mod(t_us[at_fix] * 1e-6, motion.period)
    out = np.zeros(len(at_fix), dtype=bool)
    for begin, end in scenario.gnss.outages:
        out |= (phase >= begin) & (phase < end)
    measurements: list[Measurement] = []
    for i in at_fix[~out].tolist():
        fix = _fix(scenario, int(stamps[i]), lla[i], v_l[i])
        measurements += _of_fix(config, motion.frame, fix)
    sigma = math.radians(config.heading.sigma_deg)
    yaws = yaws_of(q_lb)
    for i in _every(t_us, scenario.heading.rate).tolist():
        yaw = HeadingFix(int(stamps[i]), float(yaws[i]))
        measurements.append(
            heading.measure(yaw, yaw.t_us, motion.frame, sigma, config.heading.gate)
        )
    measurements.sort(key=lambda m: (m.t_us, m.rank))
    return Course(motion.frame, stamps, x, u, tuple(measurements))


def _every(t_us: IntArray, rate: int) -> IntArray:
    """The samples at or first after the multiples of 1 / rate."""
    wanted = np.arange(0, int(t_us[-1]) + 1, 1_000_000 // rate)
    return np.unique(np.searchsorted(t_us, wanted))


def _fix(scenario: Scenario, t_us: int, lla: FloatArray, v_l: FloatArray) -> GnssFix:
    s = scenario.gnss
    v = (float(v_l[0]), float(v_l[1]), float(v_l[2]))
    lat, lon, alt = lla.tolist()
    return GnssFix(
        t_us, lat, lon, alt, v, s.fix_type, s.satellites, s.sigma_h, s.sigma_v, s.sigma_speed
    )


def _of_fix(config: Config, frame: TangentFrame, fix: GnssFix) -> list[Measurement]:
    noise, gate = noise_of(fix, config.gnss), config.gnss.gate
    position = gnss_position.measure(fix, fix.t_us, frame, noise.h, noise.v, gate)
    velocity = gnss_velocity.measure(fix, fix.t_us, frame, noise.speed, gate)
    return [position] if velocity is None else [position, velocity]
