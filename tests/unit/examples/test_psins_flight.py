"""The PSINS scenario flown anew, and the filter that takes its increments."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavins.evaluation.consistency import errors
from mavins.examples import lever_and_delay
from mavins.examples.integrating import run_through
from mavins.examples.lever_and_delay import OFFSETS, VELOCITY, System, navigate, true_states
from mavins.examples.psins_data import DELAY, LEVER_B, POSITION_NOISE, START_SIGMA
from mavins.examples.psins_flight import Way, fly, noisy
from mavins.nav.earth import TangentFrame, dcm_ne, lla_to_ecef
from mavins.nav.layout import X_SIZE
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import Origin

pytestmark = pytest.mark.jit

PLACE = np.array([0.5, 1.85, 450.0])
SEGMENTS = np.array(
    [
        [100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        [4.0, 10.0, 0.0, -0.009, 0.0, 0.0, 0.0, 0.0],
        [45.0, 10.0, 0.0, 0.0, 0.035, -0.35, 0.0, 0.0],
        [10.0, 10.0, 0.035, 0.0, 0.0, 0.0, 0.0, 0.35],
        [5.0, 10.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0],
    ]
)
"""As in the record: stand, gain speed, lean, turn left, climb, stop."""


@pytest.fixture(scope="module")
def way() -> Way:
    return fly(SEGMENTS, PLACE)


def test_what_the_sensors_feel_leads_along_the_way(way: Way) -> None:
    """Free inertial navigation by the increments, without a fix, stays on the way."""
    flight = noisy(way, np.random.default_rng(0), np.zeros(3), 0.0)
    frame = TangentFrame.at(Origin(*flight.lla[0].tolist()))
    x = np.concatenate([true_states(flight, frame, np.zeros(1, dtype=np.int64))[0], np.zeros(3)])
    count = len(flight.lla)
    rows = np.empty((count, len(x)))
    run_through(
        x,
        np.eye(22) * 1e-12,
        np.arange(22),
        way.increments,
        10_000,
        np.zeros(4),
        frame.r0_e,
        frame.C_ne,
        frame.w_ie_n,
        np.empty((0, 3)),
        np.empty((0, 12)),
        np.ones(3),
        0.0,
        0.0,
        10,
        np.empty(count, dtype=np.int64),
        rows,
        np.empty((count, 6)),
        np.empty((count, 22, 22)),
    )
    e = errors(true_states(flight, frame, np.arange(count, dtype=np.int64)), rows[:, :X_SIZE])
    assert np.abs(e[:, :3]).max() < 0.01
    assert np.abs(e[:, 3:6]).max() < 1e-3
    assert np.abs(e[:, 6:9]).max() < 1e-6


def test_velocity_is_the_change_of_place(way: Way) -> None:
    r_e = np.array([lla_to_ecef(*lla) for lla in way.lla[::10].tolist()])
    v_e = (r_e[2:] - r_e[:-2]) / 0.2
    v_l = np.array(
        [dcm_ne(lat, lon) @ v for (lat, lon, _), v in zip(way.lla[10:-10:10], v_e, strict=True)]
    )
    assert np.abs(v_l - way.v_l[10:-10:10]).max() < 0.11  # where it brakes by 2 m/s^2
    calm = slice(0, 900)
    assert np.abs(v_l[calm] - way.v_l[10:-10:10][calm]).max() < 1e-6


def test_a_fix_is_the_antenna_a_tenth_of_a_second_later(way: Way) -> None:
    means = np.zeros(3)
    for seed in range(20):
        flight = noisy(way, np.random.default_rng(seed), LEVER_B, DELAY)
        k = 130
        at = round((k - DELAY) * 100)
        r = lla_to_ecef(*flight.fix_lla[k]) - lla_to_ecef(*way.lla[at])
        C_lb = quat_to_dcm(euler_to_quat(*way.euler[at]))
        means += (dcm_ne(way.lla[at, 0], way.lla[at, 1]) @ r - C_lb @ LEVER_B) / 20
    assert np.all(np.abs(means) < 4.0 * POSITION_NOISE / math.sqrt(20))


@pytest.mark.parametrize("system", [OFFSETS, VELOCITY], ids=lambda system: system.name)
def test_errors_keep_their_sigmas(
    way: Way, system: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lever_and_delay, "JUDGED", 100)
    random = np.random.default_rng(5)
    off = (LEVER_B, DELAY) if system.offsets else (np.zeros(3), 0.0)
    flight = noisy(way, random, *off)
    track = navigate(system, flight, random.normal(size=9) * START_SIGMA)
    sigma = np.sqrt(np.diagonal(track.rows.P[-1]))
    assert np.all(np.abs(track.last[-1, :9]) < 4.0 * sigma[:9])
    if system.offsets:
        lever, sd_lever = track.lever
        delay, sd_delay = track.delay
        assert np.all(np.abs(lever - LEVER_B) < 4.0 * sd_lever)
        assert abs(delay - DELAY) < 4.0 * sd_delay
        assert sd_delay < 0.5 * lever_and_delay.DELAY_SIGMA
        assert np.all(sd_lever < lever_and_delay.LEVER_SIGMA)


def test_true_states_are_where_the_truth_is(way: Way) -> None:
    flight = noisy(way, np.random.default_rng(0), np.zeros(3), 0.0)
    frame = TangentFrame.at(Origin(*flight.lla[0].tolist()))
    x = true_states(flight, frame, np.array([0, 1500]))
    assert x[0, :3] == pytest.approx(np.zeros(3), abs=1e-6)
    lla = frame.to_lla(x[1, :3])
    assert lla == pytest.approx(flight.lla[1500], abs=1e-9)
