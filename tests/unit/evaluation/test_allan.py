from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavins.errors import LogFormatError
from mavins.evaluation.allan import allan, analyse, overlapping_variance, standing_spell
from mavins.types import FloatArray, ImuTable


def nist_data() -> FloatArray:
    """The 1000 values of NIST SP 1065, section 12.4."""
    values = [1234567890]
    for _ in range(999):
        values.append(16807 * values[-1] % 2147483647)
    return np.array(values) / 2147483647


@pytest.mark.parametrize(
    ("m", "published"), [(1, 2.922319e-01), (10, 9.159953e-02), (100, 3.241343e-02)]
)
def test_published_deviations(m: int, published: float) -> None:
    assert overlapping_variance(nist_data(), 1.0, m) ** 0.5 == pytest.approx(published, rel=1e-6)


def noise(seed: int, seconds: float, dt: float, white: float, walk: float) -> FloatArray:
    rng = np.random.default_rng(seed)
    n = round(seconds / dt)
    steps = walk * np.sqrt(dt) * rng.standard_normal((n, 3))
    return white / np.sqrt(dt) * rng.standard_normal((n, 3)) + np.cumsum(steps, axis=0)


def test_known_densities_lie_in_their_intervals() -> None:
    white, walk = 1e-3, 1e-4
    axes = [analyse("gyro", y, 0.02) for s in range(4) for y in noise(s, 3600, 0.02, white, walk).T]
    assert all(axis.white.seen and axis.walk.seen for axis in axes)
    assert np.mean([a.white.low <= white <= a.white.high for a in axes]) >= 0.8
    assert np.mean([a.walk.low <= walk <= a.walk.high for a in axes]) >= 0.8
    assert_allclose([a.white.value for a in axes], white, rtol=0.03)
    assert_allclose(np.mean([a.walk.value for a in axes]), walk, rtol=0.2)


def test_a_short_record_shows_no_walk() -> None:
    for y in noise(1, 120, 0.01, 1e-3, 1e-5).T:
        axis = analyse("gyro", y, 0.01)
        assert axis.white.low <= 1e-3 <= axis.white.high
        assert not axis.walk.seen
        assert axis.walk.high > 1e-5


def imu(seconds: float, moved: tuple[float, float] = (0.0, 0.0)) -> ImuTable:
    """100 samples a second; pushed with 1 m/s^2 for a while."""
    t = np.arange(0.0, seconds, 0.01)
    accel_b = noise(7, seconds, 0.01, 3e-3, 0.0)
    accel_b[:, 2] -= 9.81
    accel_b[(t >= moved[0]) & (t < moved[1]), 0] += 1.0
    return ImuTable((t * 1e6).astype(np.int64), accel_b, noise(8, seconds, 0.01, 3e-4, 0.0))


def test_the_longest_standing_spell_is_used() -> None:
    table = imu(200.0, (50.0, 60.0))
    spell = standing_spell(table)
    assert (table.t_us[spell.start], spell.stop) == (60_000_000, 20_000)
    result = allan(table)
    assert result.seconds == pytest.approx(140.0, abs=0.1)
    assert result.start_s == pytest.approx(60.0)
    assert result.settings()["imu.gyro_noise"] == pytest.approx(3e-4, rel=0.05)
    assert result.settings()["imu.accel_noise"] == pytest.approx(3e-3, rel=0.05)
    assert "imu.gyro_bias_walk" not in result.settings()


def test_a_gap_ends_a_spell() -> None:
    table = imu(100.0)
    keep = (table.t_us < 30_000_000) | (table.t_us >= 31_000_000)
    cut = ImuTable(table.t_us[keep], table.accel_b[keep], table.gyro_b[keep])
    assert cut.t_us[standing_spell(cut)][0] == 31_000_000


def test_no_spell_no_figure() -> None:
    with pytest.raises(LogFormatError, match="stands still for"):
        allan(imu(25.0))
