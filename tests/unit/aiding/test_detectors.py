"""The zero-velocity detectors against their formulas, and online against the whole log."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mavins.aiding.detectors import KINDS, AdaptiveThreshold, Detector, gnss_speed
from mavins.types import FloatArray, GnssFix

G = 9.81
SIGMA_F, SIGMA_W = 0.02, 0.003
STEP_US = 5_000


def shoe(w: FloatArray, f: FloatArray) -> float:
    up = f.mean(axis=0) / np.linalg.norm(f.mean(axis=0))
    force = ((f - G * up) ** 2).sum(axis=1) / SIGMA_F**2
    return float((force + (w**2).sum(axis=1) / SIGMA_W**2).mean())


FORMULAS: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "shoe": shoe,
    "ared": lambda w, f: float((w**2).sum() / len(w) / SIGMA_W**2),
    "amvd": lambda w, f: float(((f - f.mean(axis=0)) ** 2).sum() / len(f) / SIGMA_F**2),
    "mag": lambda w, f: float(((np.linalg.norm(f, axis=1) - G) ** 2).mean() / SIGMA_F**2),
}


def detector(kind: str, window: int = 5) -> Detector:
    return Detector(kind, window, SIGMA_F, SIGMA_W, G)


def gait(steps: int = 4, rows: int = 200, vigour: float = 1.0) -> FloatArray:
    """(N, 6): a second a step, half of it a swing, half of it standing with white noise."""
    rng = np.random.default_rng(3)
    imu = rng.normal(size=(steps * rows, 6)) * np.repeat([SIGMA_W, SIGMA_F], 3)
    imu[:, 5] -= G
    phase = np.arange(len(imu)) % rows / rows
    swing = np.where(phase < 0.5, np.sin(2 * np.pi * phase), 0.0) * vigour
    imu[:, 1] += 8.0 * swing
    imu[:, 3] += 20.0 * swing
    return imu


def stamps(imu: FloatArray) -> np.ndarray:
    return np.arange(len(imu), dtype=np.int64) * STEP_US


@pytest.mark.parametrize("kind", KINDS)
def test_statistic_is_its_formula(kind: str) -> None:
    imu = gait(1)
    got = detector(kind).statistics(imu)
    for k in range(len(imu)):
        rows = imu[max(0, k - 4) : k + 1]
        assert_allclose(got[k], FORMULAS[kind](rows[:, :3], rows[:, 3:]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_online_is_the_whole_log_bit_for_bit(kind: str) -> None:
    imu, rule = gait(2), AdaptiveThreshold(memory=0.3, floor=1.0)
    t_us, d = stamps(imu), detector(kind)
    whole = d.statistics(imu)
    limits = rule.over_log(t_us, whole)
    kept = slice(0, 0)
    for k in range(len(imu)):
        assert d.latest(imu[: k + 1]) == d.latest(imu[max(0, k - 4) : k + 1]) == whole[k]
        kept = slice(max(0, k - 60), k + 1)
        assert rule.latest(t_us[kept], whole[kept]) == limits[k]


def test_each_detector_tells_swing_from_standing() -> None:
    imu = gait()
    phase = np.arange(len(imu)) % 200 / 200
    swing, still = (phase > 0.1) & (phase < 0.4), phase > 0.6
    for kind in KINDS:
        values = detector(kind).statistics(imu)
        # an acceleration that does not change is hidden from its variance, so that one is the weakest
        factor = 2.0 if kind == "amvd" else 100.0
        assert np.median(values[swing]) > factor * np.median(values[still]), kind


def test_what_each_detector_is_blind_to() -> None:
    rest = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -G], (5, 1))
    turning, pushed = rest.copy(), rest.copy()
    turning[:, 2] = 1.0
    pushed[:, 3] = 3.0
    seen = {
        kind: [detector(kind).latest(rows) > 1.0 for rows in (rest, turning, pushed)]
        for kind in KINDS
    }
    assert seen == {
        "shoe": [False, True, True],
        "ared": [False, True, False],
        "amvd": [False, False, False],
        "mag": [False, False, True],
    }


def test_free_fall_is_not_standing() -> None:
    assert detector("shoe").latest(np.zeros((5, 6))) == pytest.approx(G**2 / SIGMA_F**2)


@pytest.mark.parametrize("kind", ["shoe", "ared", "amvd"])
def test_statistic_grows_with_the_motion(kind: str) -> None:
    swing = [detector(kind).statistics(gait(1, vigour=v))[20:80].mean() for v in (0.1, 0.3, 1.0)]
    assert swing[0] < swing[1] < swing[2]


def test_threshold_lies_between_stance_and_swing_in_the_logarithm() -> None:
    values = np.array([1e2, 1e6, 1e3, 1e4])
    t_us = np.array([0, 100_000, 200_000, 300_000])
    half = AdaptiveThreshold(memory=0.25, share=0.5, floor=1.0)
    # at the last row the first is older than the memory
    assert_allclose(half.over_log(t_us, values), [1e2, 1e4, 1e4, 10**4.5])
    assert_allclose(AdaptiveThreshold(0.25, 0.25, 1.0).latest(t_us, values), 10**3.75)
    assert_array_equal(AdaptiveThreshold(0.25, 0.5, 1e5).over_log(t_us, values), np.full(4, 1e5))


def test_threshold_follows_the_gait() -> None:
    """A run whose foot is never still: the constant of a walk finds none of its steps, the adaptive one all."""
    imu = gait(vigour=1.0)
    imu[:, 0] += 2.0
    values = detector("shoe").statistics(imu)
    rule = AdaptiveThreshold(memory=1.0, floor=1e4)
    stands = values < rule.over_log(stamps(imu), values)
    still = np.arange(len(imu)) % 200 / 200 > 0.6
    assert not (values < rule.floor).any()
    assert stands[still][40:].all()
    assert stands.mean() < 0.7


def test_gnss_speed_is_horizontal() -> None:
    assert gnss_speed(GnssFix(0, 0.0, 0.0, 0.0, (3.0, 4.0, 9.0), 3)) == 5.0
    assert math.isnan(gnss_speed(GnssFix(0, 0.0, 0.0, 0.0, (math.nan, 4.0, 0.0), 3)))
    assert math.isnan(gnss_speed(GnssFix(0, 0.0, 0.0, 0.0, None, 3)))
