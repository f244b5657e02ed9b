"""What of an acceleration is signal, and a delay that a flight shows."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.latency import signal_share
from mavins.estimator.settings import StatesSettings
from mavins.examples.scenarios import flight, matched
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_SIZE
from mavins.nav.so3 import euler_to_quat, quat_exp, quat_mul, quat_to_dcm
from sitl.scenario import load

G = np.array([0.0, 0.0, 9.81])


def test_the_variance_is_that_of_the_acceleration() -> None:
    rng = np.random.default_rng(3)
    x = np.zeros(X_SIZE)
    x[6:10] = euler_to_quat(0.2, -0.4, 1.0)
    root = rng.normal(size=(15, 15)) * np.repeat([1, 1, 0.01, 1, 0.1], 3)[:, None]
    P = root @ root.T
    f_b = quat_to_dcm(x[6:10]).T @ (np.array([1.0, 0.5, 0.0]) - G)
    errors = rng.multivariate_normal(np.zeros(15), P, 20000)
    turned = [quat_to_dcm(quat_mul(x[6:10], quat_exp(e[6:9]))) @ (f_b - e[12:15]) for e in errors]
    variance = np.var(turned, axis=0).sum()
    share = signal_share(x, P, f_b, G)
    assert share == pytest.approx(1.25 / (1.25 + variance), rel=0.03)


@pytest.mark.jit
@pytest.mark.parametrize(("latency", "believed"), [(0.18, 0.0), (-0.1, 0.0), (0.05, 0.2)])
def test_the_delay_is_found(latency: float, believed: float) -> None:
    """Also one below zero, where a fix waits for its IMU samples; within three sigmas and 20 ms."""
    scenario = load("quad_mission")
    gnss = dataclasses.replace(scenario.gnss, latency=max(latency, 0.0))
    scenario = dataclasses.replace(scenario, gnss=gnss)
    config = matched(Config(), scenario)
    states = StatesSettings(gnss_delay="estimate", gnss_delay_sigma=0.2)
    config = dataclasses.replace(config, states=states)
    tape, _ = flight(config, scenario, 3, 60.0)
    last: list[tuple[float, float, int]] = []

    def take(block: RowBlock, _: TangentFrame) -> None:
        k = block.count - 1
        last.append((block.x[k, 19], math.sqrt(block.P[k, -1, -1]), int(block.t_us[k])))

    estimator = Estimator(config, "eskf", Outputs(1_000_000, take))
    early = round(min(latency, 0.0) * 1e6)
    for name, what in tape.feeds:
        if name == "feed_gnss":
            # a latency below zero: the stamp lies before the instant
            what = dataclasses.replace(what, t_us=what.t_us + early, delay=believed)
        getattr(estimator, name)(what)
    estimator.finish()
    tau, sigma, _ = last[-1]
    assert sigma < 0.02
    assert abs(tau - latency) < 3.0 * sigma
    assert abs(tau - latency) < 0.02
