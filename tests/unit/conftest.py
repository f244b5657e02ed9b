"""A result as an honest filter would leave it, to be spoilt by whoever tests what finds faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavins.config import Config, load
from mavins.estimates import Estimates, Innovations, Result
from mavins.evaluation.errors import Errors
from mavins.evaluation.evidence import Evidence, Gnss, ImuSeconds
from mavins.evaluation.spectrum import LENGTH, Spectrum
from mavins.logs.truth import Truth
from mavins.nav.layout import Layout
from mavins.results import width
from mavins.types import FloatArray, IntArray

SECONDS = 200
SETTINGS: dict[str, Any] = {
    "imu.gyro_noise": 0.001,
    "imu.accel_noise": 0.02,
    "gnss.delay": 0.0,
    "gnss.position_floor": 0.01,
    "gnss.velocity_floor": 0.01,
    "heading.sigma_deg": 2.0,
    "states.gnss_delay": "fixed",
}


def velocity(t: FloatArray) -> FloatArray:
    """North and east swing to and fro, at 2.5 m/s^2."""
    return np.column_stack([5.0 * np.sin(0.5 * t), 4.0 * np.cos(0.7 * t), 0.1 * np.sin(t)])


def place(t: FloatArray) -> FloatArray:
    """Latitude and longitude in rad, altitude in m."""
    swing = np.column_stack([-10.0 * np.cos(0.5 * t), 5.7 * np.sin(0.7 * t), 0.1 * np.cos(t)])
    return np.array([0.8, 0.1, 500.0]) + swing * [1 / 6.378e6, 1 / 4.44e6, 1.0]


def estimates(rng: np.random.Generator) -> tuple[Estimates, Errors]:
    t_us = np.arange(10_000_000, 10_000_000 + SECONDS * 1_000_000, 20_000)
    t = t_us * 1e-6
    pos, vel, att = (slow(rng, len(t), s) for s in (0.2, 0.05, 0.02))
    layout = Layout.of()
    e = Estimates(t_us, np.zeros((len(t), width(layout))), layout)
    e.lla[:], e.v[:] = place(t), velocity(t)
    sigmas = {"p_n": 0.2, "v": 0.05, "euler": 0.02, "b_g": 0.001, "b_a": 0.02}
    for name, sigma in sigmas.items():
        e.state(name)[1][:] = sigma
    return e, Errors(t_us, pos, vel, att)


def slow(rng: np.random.Generator, n: int, sigma: float) -> FloatArray:
    """Errors (n, 3) that last for two seconds."""
    out = np.empty((n, 3))
    out[0] = sigma * rng.standard_normal(3)
    keep = math.exp(-0.02 / 2.0)
    drive = sigma * math.sqrt(1.0 - keep**2) * rng.standard_normal((n, 3))
    for k in range(1, n):
        out[k] = keep * out[k - 1] + drive[k]
    return out


def white(rng: np.random.Generator, t_us: IntArray, sigma: list[float]) -> Innovations:
    r = np.array(sigma) * rng.standard_normal((len(t_us), len(sigma)))
    nis = ((r / sigma) ** 2).sum(axis=1)
    n = len(t_us)
    return Innovations(
        t_us,
        t_us.copy(),
        np.full(n, "test"),
        np.ones(n, dtype=bool),
        np.full(n, "", dtype="U20"),
        nis,
        r,
        np.tile(sigma, (n, 1)),
    )


def evidence(rng: np.random.Generator, e: Estimates) -> Evidence:
    t_us = np.arange(10_000_000, int(e.t_us[-1]), 200_000)
    n, seconds = len(t_us), np.arange(10, 10 + SECONDS, dtype=np.int64) * 1_000_000
    frequency = np.arange(2, LENGTH // 2 + 1) * 200.0 / LENGTH
    density = np.array([0.001] * 3 + [0.02] * 3)
    intervals = np.zeros(2001, dtype=np.int64)
    intervals[50] = 200 * SECONDS
    t = e.t_us * 1e-6
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
    return Evidence(
        Gnss(
            t_us,
            place(t_us * 1e-6) + rng.standard_normal((n, 3)) * [1e-7, 1e-7, 0.8],
            velocity(t_us * 1e-6),
            np.full(n, 3),
            np.full(n, 12.0),
            np.tile([0.5, 0.8, 0.1], (n, 1)),
        ),
        ImuSeconds(
            seconds,
            np.full(SECONDS, 200),
            np.full(SECONDS, 5_000),
            np.full((SECONDS, 6), 0.1),
            np.zeros(SECONDS, dtype=np.int64),
            intervals,
        ),
        Spectrum(frequency, np.tile(2.0 * density**2, (len(frequency), 1)), 150, 200.0),
        t_us,
        np.zeros(n),
        np.empty(0, dtype=np.int64),
        t_us,
        truth=Truth(e.t_us, place(t), velocity(t), q, "simulator"),
    )


def settings(**others: Any) -> Config:
    return load(None, SETTINGS | others)


@pytest.fixture
def config() -> Callable[..., Config]:
    """Settings that match the clean result, with others laid over them: `config(**{"gnss.delay": 0.1})`."""
    return settings


@pytest.fixture(scope="session")
def clean() -> Result:
    """Matched noises, white innovations, errors inside their sigmas, no gaps."""
    rng = np.random.default_rng(7)
    e, errors = estimates(rng)
    fixes = np.arange(10_000_000, int(e.t_us[-1]), 200_000)
    innovations = {
        "gnss_position": white(rng, fixes, [0.52, 0.52, 0.82]),
        "gnss_velocity": white(rng, fixes, [0.11, 0.11, 0.11]),
        "heading": white(rng, fixes, [0.036]),
    }
    summary = {
        "mavins": "0",
        "log": "flights/clean.tlog",
        "filter": "eskf",
        "imu": {"message": "HIGHRES_IMU", "id": 0},
        "imu_samples": 200 * SECONDS,
        "health": "running",
        "reason": "",
        "resets": 0,
        "realignments": 0,
        "reboots": 0,
        "rows": len(e),
        "log_s": float(SECONDS),
        "damage": {"bad_crc": 0, "unknown": 3},
        "truth": {
            "source": "simulator",
            "rms": {"pos_m": [0.2, 0.2, 0.2]},
            "max": {"pos_m": [0.6, 0.6, 0.6]},
        },
        "aiding": {
            "gnss_position": {"accepted": len(fixes), "assumed_noise": [0.5, 0.5, 0.8]},
            "gnss_velocity": {"accepted": len(fixes), "assumed_noise": [0.1, 0.1, 0.1]},
            "heading": {"accepted": len(fixes), "assumed_noise": [math.radians(2.0)]},
        },
    }
    return Result(
        e.t_us,
        e.table,
        e.layout,
        settings(),
        innovations,
        evidence(rng, e),
        errors,
        None,
        summary,
    )
