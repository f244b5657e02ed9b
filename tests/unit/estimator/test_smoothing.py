"""A flight smoothed: better than filtered where there is a truth, honest about it, and in pieces where it broke."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.history import History
from mavins.estimator.settings import Settings
from mavins.estimator.smoothing import smooth
from mavins.evaluation.consistency import errors, nees
from mavins.evaluation.errors import interpolate_truth
from mavins.evaluation.tape import Tape
from mavins.examples.scenarios import flight, matched
from mavins.filters import REGISTRY, RowBlock
from mavins.logs.truth import Truth
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_G
from mavins.nav.so3 import dcm_to_quat, quat_conj, quat_mul
from mavins.types import FloatArray
from sitl.scenario import load

pytestmark = pytest.mark.jit

SECOND_US = 1_000_000


@functools.cache
def flown() -> tuple[Tape, Truth]:
    scenario = load("quad_mission")
    return flight(matched(Config(), scenario), scenario, 4, 60.0)


def copy_of(block: RowBlock) -> RowBlock:
    n = block.count
    parts = (a[:n].copy() for a in (block.t_us, block.x, block.u, block.P))
    return RowBlock(*parts, count=n)


def joined(blocks: list[RowBlock]) -> RowBlock:
    parts = [np.concatenate([getattr(b, name) for b in blocks]) for name in ("t_us", "x", "u", "P")]
    return RowBlock(*parts, count=len(parts[0]))


def both(
    name: str, feeds: list[tuple[str, Any]], settings: Settings | None = None
) -> tuple[RowBlock, RowBlock, Estimator, list[TangentFrame]]:
    """Filtered rows, smoothed rows, the estimator and the frame of each smoothed block."""
    settings = settings or flown()[0].settings
    filtered: list[RowBlock] = []
    history = History()

    def take(block: RowBlock, _: TangentFrame) -> None:
        filtered.append(copy_of(block))

    tape = Tape(settings)
    tape.feeds = feeds
    estimator = Estimator(settings, name, Outputs(100_000, take, None, history))
    tape.play(estimator)
    blocks = list(smooth(history))
    blocks.reverse()
    frames = [frame for _, frame in blocks]
    return joined(filtered), joined([block for block, _ in blocks]), estimator, frames


def true_states(rows: RowBlock, frame: TangentFrame) -> FloatArray:
    lla, v_l, q_lb, _ = interpolate_truth(rows.t_us, *flown()[1].columns())
    x = rows.x.copy()
    for k in range(len(x)):
        C_ln = frame.local_level(lla[k, 0], lla[k, 1])
        x[k, 0:3] = frame.from_lla(*lla[k])
        x[k, 3:6] = C_ln.T @ v_l[k]
        x[k, 6:10] = quat_mul(quat_conj(dcm_to_quat(C_ln)), q_lb[k])
    return x


@pytest.mark.parametrize(
    "name", [n if n == "eskf" else pytest.param(n, marks=pytest.mark.slow) for n in REGISTRY]
)
def test_a_flight_is_better_known_afterwards(name: str) -> None:
    filtered, smoothed, estimator, frames = both(name, flown()[0].feeds)
    assert estimator.reset_counter == 0
    np.testing.assert_array_equal(smoothed.t_us, filtered.t_us)
    e = errors(true_states(smoothed, frames[0]), smoothed.x)[:, :9]
    before = errors(true_states(filtered, frames[0]), filtered.x)[:, :9]
    rms, rms_before = (np.sqrt(np.mean(a**2, axis=0)) for a in (e, before))
    assert np.all(rms[:6] < 0.85 * rms_before[:6])
    assert np.mean(rms[6:] / rms_before[6:]) < 1.0
    sigma, sigma_before = (
        np.sqrt(np.diagonal(b.P, axis1=1, axis2=2)) for b in (smoothed, filtered)
    )
    assert np.all(sigma <= 1.001 * sigma_before)
    unit = smoothed.P / sigma[:, :, None] / sigma[:, None, :]
    assert np.linalg.eigvalsh(unit).min() > 0.0
    np.testing.assert_array_equal(smoothed.P, smoothed.P.transpose(0, 2, 1))
    # nine degrees of freedom, correlated from row to row
    assert 4.0 < np.mean(nees(e, smoothed.P[:, :9, :9])) < 18.0


def test_gravity_is_the_same_before_and_after() -> None:
    """What does not change is known as well at the start as at the end, where the filter knows it best."""
    settings = flown()[0].settings
    states = dataclasses.replace(settings.states, gravity="estimate")
    settings = dataclasses.replace(settings, states=states)
    filtered, smoothed, estimator, frames = both("eskf", flown()[0].feeds, settings)
    assert estimator.filter.layout.blocks[-1] == "g_n"
    assert np.ptp(smoothed.x[:, X_G], axis=0).max() < 1e-9
    # a fix more may come after the last row
    np.testing.assert_allclose(smoothed.x[-1, X_G], filtered.x[-1, X_G], atol=1e-5)
    g = smoothed.P[:, 15:, 15:]
    np.testing.assert_allclose(g, np.broadcast_to(g[-1], g.shape), rtol=1e-6)
    np.testing.assert_allclose(g[-1], filtered.P[-1, 15:, 15:], rtol=0.02, atol=1e-8)
    assert filtered.P[0, 15, 15] > 10.0 * g[0, 0, 0]
    e = errors(true_states(smoothed, frames[0]), smoothed.x)[:, :9]
    assert 4.0 < np.mean(nees(e, smoothed.P[:, :9, :9])) < 18.0


def test_the_second_run_ends_where_the_filter_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a rewind and in segments, yet to the bit."""
    ends: list[tuple[FloatArray, FloatArray]] = []

    def keep(_: Any, __: Any, x: FloatArray, P: FloatArray, *___: Any) -> None:
        ends.append((x[-1].copy(), P[-1].copy()))

    monkeypatch.setattr("mavins.estimator.smoothing.smooth_back", keep)
    _, _, estimator, _ = both("eskf", flown()[0].feeds)
    assert len(ends) > 2
    solution = estimator.solution()
    assert solution is not None
    x, P = ends[0]
    np.testing.assert_array_equal(x[:10], [*solution.p_n, *solution.v_n, *solution.q_nb])
    np.testing.assert_array_equal(x[10:16], [*solution.b_g, *solution.b_a])
    np.testing.assert_array_equal(P, solution.P)


def _stamp(feed: tuple[str, Any]) -> int:
    name, what = feed
    return int(what.t_us[0]) if name == "feed_imu" else getattr(what, "t_us", 0)


def test_a_gap_makes_two_stretches() -> None:
    start = int(flown()[1].t_us[0])
    hole = (start + 30 * SECOND_US, start + 35 * SECOND_US)
    feeds = [f for f in flown()[0].feeds if not hole[0] < _stamp(f) < hole[1]]
    filtered, smoothed, estimator, _ = both("eskf", feeds)
    assert estimator.realignments == 1
    np.testing.assert_array_equal(smoothed.t_us, filtered.t_us)
    # before the gap all is as if nothing came after it
    ended = both("eskf", [f for f in feeds if _stamp(f) <= hole[0]])[1]
    np.testing.assert_array_equal(smoothed.P[: ended.count], ended.P)
    np.testing.assert_array_equal(smoothed.x[: ended.count], ended.x)


def test_what_comes_after_a_reset_is_not_passed_back() -> None:
    """Fixes 200 m off, until the filter gives in: before, the smoothed position stays where it was."""
    start = int(flown()[1].t_us[0])
    jump_us = start + 40 * SECOND_US
    feeds = []
    for name, what in flown()[0].feeds:
        if name == "feed_gnss" and what.t_us > jump_us:
            what = dataclasses.replace(what, lat=what.lat + 200.0 / 6.37e6)
        feeds.append((name, what))
    filtered, smoothed, estimator, _ = both("eskf", feeds)
    assert estimator.reset_counter >= 1
    np.testing.assert_array_equal(smoothed.t_us, filtered.t_us)
    d = np.abs(smoothed.x[:, 0] - filtered.x[:, 0])
    assert d[filtered.t_us < jump_us].max() < 10.0
    assert np.abs(np.diff(smoothed.x[:, 0])).max() > 150.0
