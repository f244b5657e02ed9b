"""The example on a walk made up here, and how a track is held against the truth."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.examples import drawing
from mavins.examples.base import MissingDataError
from mavins.examples.foot_data import Recording
from mavins.examples.foot_mounted import (
    OPENSHOE_ORIGIN,
    horizontal_rms,
    navigate,
    run,
    turned_onto,
)

RATE = 200


def walk_north(steps: int, swing: float) -> Recording:
    """Steps north, a second each: for half of it the foot flies and rolls there and back, for half of it it stands."""
    rng = np.random.default_rng(1)
    phase = np.arange(steps * RATE) % RATE / RATE
    flying = phase < 0.5
    imu = rng.normal(size=(len(phase), 6)) * np.repeat([0.005, 0.02], 3)
    roll = np.where(flying, 6.0 * (1.0 - np.cos(4 * np.pi * phase)) / (4 * np.pi), 0.0)
    imu[:, 0] += np.where(flying, 6.0 * np.sin(4 * np.pi * phase), 0.0)
    imu[:, 3] += np.where(flying, swing * np.sin(4 * np.pi * phase), 0.0)
    imu[:, 4] -= 9.8186 * np.sin(roll)
    imu[:, 5] -= 9.8186 * np.cos(roll)
    t_us = np.arange(len(phase), dtype=np.int64) * (1_000_000 // RATE)
    return Recording("north", t_us, imu)


@pytest.mark.jit
def test_a_straight_walk_comes_out_straight_and_as_long_as_it_is() -> None:
    swing = 10.0
    walk = navigate(walk_north(8, swing), OPENSHOE_ORIGIN)
    stride = swing * 0.5 / (4 * np.pi)
    assert walk.p_n[-1, 0] == pytest.approx(8 * stride, rel=0.02)
    assert_allclose(walk.p_n[-1, 1:], 0.0, atol=0.1)
    assert walk.length == pytest.approx(8 * stride, rel=0.05)
    assert 0.3 < walk.standing.mean() < 0.7


def test_turned_onto_finds_the_turn_and_nothing_else() -> None:
    rng = np.random.default_rng(2)
    truth = rng.normal(size=(50, 2)).cumsum(axis=0)
    c, s = math.cos(0.3), math.sin(0.3)
    # a track turned back by 0.3 rad, elsewhere, and 10 % too long
    track = 1.1 * (truth - truth[0]) @ np.array([[c, -s], [s, c]]) + 7.0
    yaw, turned = turned_onto(track, truth)
    assert yaw == pytest.approx(0.3)
    assert_allclose(turned, 1.1 * (truth - truth[0]), atol=1e-12)
    expected = 0.1 * np.sqrt(((truth - truth[0]) ** 2).sum(axis=1).mean())
    assert horizontal_rms(turned, truth) == pytest.approx(expected)


def test_an_empty_folder_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match="openshoe"):
        run(tmp_path, None, print)
    (tmp_path / "zupt" / "openshoe").mkdir(parents=True)
    with pytest.raises(MissingDataError, match="loop_"):
        run(tmp_path, None, print)


def test_without_matplotlib_there_is_a_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    # another test may have had it imported
    monkeypatch.delitem(sys.modules, "mavins.evaluation.pictures", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    said: list[str] = []
    assert drawing.pyplot(said.append) is None
    assert said == [drawing.HINT]
    assert "mavins[report]" in drawing.HINT
