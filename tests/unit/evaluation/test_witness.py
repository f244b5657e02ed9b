"""What stands in front of an estimator hands on everything, and keeps what a report needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavins.errors import LogFormatError
from mavins.estimates import Result
from mavins.estimator.settings import Settings
from mavins.evaluation.evidence import Evidence, read_evidence, thinned, write_evidence
from mavins.evaluation.spectrum import Welch
from mavins.evaluation.tape import Tape
from mavins.evaluation.witness import Witness
from mavins.logs.truth import Truth
from mavins.types import (
    BaroSample,
    FloatArray,
    GnssFix,
    HeadingFix,
    ImuTable,
    IntArray,
    MagSample,
    Origin,
)

RATE = 200


def stamps(seconds: float, rate: float = RATE) -> IntArray:
    return np.round(np.arange(0.0, seconds, 1.0 / rate) * 1e6).astype(np.int64) + 5_000_000


def feed(witness: Witness, t_us: IntArray, rows: FloatArray, at_a_time: int) -> None:
    for k in range(0, len(t_us), at_a_time):
        part = slice(k, k + at_a_time)
        witness.feed_imu(ImuTable(t_us[part], rows[part, 3:], rows[part, :3]))


def test_everything_is_handed_on() -> None:
    tape = Tape(Settings())
    witness = Witness(tape)
    table = ImuTable(stamps(0.1), np.zeros((20, 3)), np.zeros((20, 3)))
    fix = GnssFix(5_000_000, 0.8, 0.1, 500.0, (1.0, 2.0, 3.0), 3, None, 0.5)
    heading, mag = HeadingFix(5_000_000, 1.0), MagSample(5_000_000, np.ones(3))
    baro, origin, other = BaroSample(5_000_000, 1.0), Origin(0.8, 0.1, 0.0), Settings()
    witness.set_origin(origin)
    witness.reconfigure(other)
    witness.restart("reboot")
    assert witness.calibrate("asked")
    witness.feed_imu(table)
    witness.feed_gnss(fix)
    witness.feed_heading(heading)
    witness.feed_mag(mag)
    witness.feed_baro(baro)
    assert witness.settings is tape.settings
    handed = [what for _, what in tape.feeds]
    assert handed == [origin, other, "reboot", "asked", table, fix, heading, mag, baro]
    kept = witness.evidence()
    assert kept.gnss.lla.tolist() == [[0.8, 0.1, 500.0]]
    assert kept.gnss.v_l.tolist() == [[1.0, 2.0, 3.0]]
    assert np.isnan(kept.gnss.satellites).all()
    assert kept.gnss.sigmas[0, 0] == 0.5
    assert np.isnan(kept.gnss.sigmas[0, 1:]).all()
    assert (kept.yaw.tolist(), kept.heading_us.tolist()) == ([1.0], [5_000_000])
    assert (len(kept.mag_us), len(kept.baro_us)) == (1, 1)


def test_how_rows_are_grouped_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    t_us, rows = stamps(200.0), rng.standard_normal((200 * RATE, 6))
    parts = []
    for at_a_time in (7, 5000, len(t_us)):
        witness = Witness(Tape(Settings()))
        feed(witness, t_us, rows, at_a_time)
        parts.append(witness.evidence())
    for other in parts[1:]:
        assert np.array_equal(parts[0].imu.count, other.imu.count)
        assert np.array_equal(parts[0].imu.intervals, other.imu.intervals)
        assert parts[0].imu.spread == pytest.approx(other.imu.spread, rel=1e-9)
        assert parts[0].spectrum is not None
        assert other.spectrum is not None
        assert parts[0].spectrum.psd == pytest.approx(other.spectrum.psd, rel=1e-9)
    assert parts[0].imu.count.tolist() == [RATE] * 200
    assert parts[0].imu.spread.mean() == pytest.approx(1.0, abs=0.02)
    assert int(parts[0].imu.intervals[50]) == len(t_us) - 1


def test_gaps_and_clipping() -> None:
    t_us, rows = stamps(20.0), np.zeros((20 * RATE, 6))
    rows[100:103, 5] = -160.0
    kept = np.ones(len(t_us), dtype=bool)
    kept[2000:2100] = False
    witness = Witness(Tape(Settings()))
    feed(witness, t_us[kept], rows[kept], 64)
    imu = witness.evidence().imu
    assert imu.clipped.sum() == 3
    assert imu.longest_us.max() == 505_000
    assert imu.t_us[np.argmax(imu.longest_us)] == 15_000_000
    assert imu.intervals[-1] == 1


def test_a_clock_that_goes_back_is_no_interval() -> None:
    witness = Witness(Tape(Settings()))
    t_us = np.concatenate([stamps(3.0), stamps(3.0)])
    feed(witness, t_us, np.zeros((len(t_us), 6)), 50)
    imu = witness.evidence().imu
    assert imu.intervals.sum() == len(t_us) - 2
    assert imu.longest_us.max() == 5_000


def test_nothing_was_fed() -> None:
    kept = Witness(Tape(Settings())).evidence()
    assert (len(kept.imu.t_us), len(kept.gnss.t_us), kept.spectrum) == (0, 0, None)


@pytest.mark.parametrize("at_a_time", [100, 3000])
def test_white_noise_has_the_density_it_was_made_with(at_a_time: int) -> None:
    rng = np.random.default_rng(2)
    density = np.array([1e-3, 2e-3, 3e-3, 0.02, 0.03, 0.04])
    t_us = stamps(300.0)
    rows = density * np.sqrt(RATE) * rng.standard_normal((len(t_us), 6))
    rows[:, 0] += np.sin(2 * np.pi * 1.3 * t_us * 1e-6)  # the vehicle's motion
    rows[:, 4] += 2.0 * np.sin(2 * np.pi * 57.0 * t_us * 1e-6)  # a propeller
    welch = Welch()
    for k in range(0, len(t_us), at_a_time):
        welch.take(t_us[k : k + at_a_time], rows[k : k + at_a_time])
    found = welch.spectrum()
    assert found is not None
    assert found.rate == pytest.approx(RATE)
    assert found.noise_density() == pytest.approx(density, rel=0.05)
    assert found.noise_density(20.0) == pytest.approx(density, rel=0.1)
    peak = found.frequency[np.argmax(found.psd[:, 4])]
    assert peak == pytest.approx(57.0, abs=0.5)


def test_a_slow_imu_does_not_show_its_noise() -> None:
    welch = Welch()
    welch.take(stamps(100.0, 20.0), np.random.default_rng(0).standard_normal((2000, 6)))
    found = welch.spectrum()
    assert found is not None
    assert np.isnan(found.noise_density()).all()


def test_a_segment_with_a_gap_is_left_out() -> None:
    t_us = stamps(600 / RATE)
    t_us[300:] += 3_000_000
    welch = Welch()
    welch.take(t_us, np.zeros((600, 6)))
    assert welch.spectrum() is None


def test_evidence_comes_back_as_it_was_written(clean: Result, tmp_path: Path) -> None:
    path = tmp_path / "evidence.npz"
    assert read_evidence(path) is None
    written = clean.evidence
    assert written is not None
    sigmas = np.full((3, 6), 0.5)
    write_evidence(path, written, sigmas)
    found, told = read_evidence(path) or (None, None)
    assert isinstance(found, Evidence)
    assert np.array_equal(told, sigmas)
    for part in ("gnss", "imu", "spectrum", "truth"):
        one, other = getattr(found, part), getattr(written, part)
        for name in one.__slots__:
            assert np.array_equal(
                getattr(one, name), getattr(other, name), equal_nan=name != "source"
            )
    assert found.reference is None
    assert [p.name for p in tmp_path.iterdir()] == ["evidence.npz"]
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(LogFormatError, match=r"evidence.npz is damaged"):
        read_evidence(path)


def test_a_quick_truth_is_thinned() -> None:
    n = 4000
    t_us = np.arange(n, dtype=np.int64) * 2_500
    truth = Truth(t_us, np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 4)), "SIM")
    found = thinned(truth)
    assert found is not None
    assert found.source == "SIM"
    assert len(found) == pytest.approx(10.0 / 0.009, rel=0.2)
    assert np.diff(found.t_us).max() <= 12_500
    assert thinned(None) is None
