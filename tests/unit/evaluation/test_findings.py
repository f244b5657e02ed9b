"""Each rule speaks where it must, and is silent about a flight with nothing wrong."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimates import Innovations, Result
from mavins.evaluation.findings import Finding, findings
from mavins.nav.layout import CORE, Layout
from mavins.results import width

replace = dataclasses.replace


def said(result: Result, *levels: str) -> list[Finding]:
    return [f for f in findings(result) if f.level in (levels or ("wrong", "note"))]


def the(result: Result, words: str) -> Finding:
    """The only finding that is not fine and has these words."""
    (found,) = [f for f in said(result) if words in f.text]
    return found


def with_innovations(result: Result, name: str, **changes: Any) -> Result:
    spoilt = replace(result.innovations[name], **changes)
    return replace(result, innovations=result.innovations | {name: spoilt})


def with_imu(result: Result, **changes: Any) -> Result:
    assert result.evidence is not None
    imu = replace(result.evidence.imu, **changes)
    return replace(result, evidence=replace(result.evidence, imu=imu))


def with_gnss(result: Result, **changes: Any) -> Result:
    assert result.evidence is not None
    gnss = replace(result.evidence.gnss, **changes)
    return replace(result, evidence=replace(result.evidence, gnss=gnss))


def with_state(result: Result, name: str, values: Any, sigmas: Any = None) -> Result:
    """The result with a state of these values, and sigmas, whether it had it or not."""
    if not result.has(name):
        layout = Layout.of((*CORE, name))
        further = np.zeros((len(result), width(layout) - result.table.shape[1]))
        table = np.hstack([result.table[:, :-6], further, result.table[:, -6:]])
        result = replace(result, table=table, layout=layout)
    result = replace(result, table=result.table.copy())
    for place, value in zip(result.state(name), (values, sigmas), strict=True):
        if value is not None:
            place[:] = value
    return result


def with_summary(result: Result, **changes: Any) -> Result:
    return replace(result, summary=result.summary | changes)


def scaled(innovations: Innovations, factor: float) -> dict[str, Any]:
    return {
        "innovation": factor * innovations.innovation,
        "nis": factor**2 * innovations.nis,
    }


def test_nothing_is_wrong_with_a_clean_flight(clean: Result) -> None:
    assert said(clean) == []
    fine = " ".join(f.text for f in said(clean, "fine"))
    for words in ("fit in time", "are white", "as large as expected", "200 Hz, without gaps"):
        assert words in fine
    assert "sigmas fit" in fine
    assert "gyro noise" in fine


def test_the_worst_comes_first(clean: Result) -> None:
    spoilt = with_summary(clean, resets=2, damage={"bad_crc": 7})
    assert [f.level for f in findings(spoilt)[:3]] == ["wrong", "note", "fine"]


def test_no_estimate(clean: Result) -> None:
    spoilt = replace(clean, t_us=clean.t_us[:0], table=clean.table[:0], errors=None, innovations={})
    spoilt = with_summary(spoilt, health="aligning", reason="no GNSS fix yet")
    assert "no GNSS fix yet" in the(spoilt, "no estimate").text


def test_lost_at_the_end_reset_and_begun_anew(clean: Result) -> None:
    assert the(with_summary(clean, health="diverged"), "not running").level == "wrong"
    assert the(with_summary(clean, resets=2), "reset to GNSS 2 times").level == "wrong"
    assert the(with_summary(clean, realignments=1), "began anew").level == "wrong"
    assert the(with_summary(clean, reboots=1), "rebooted").level == "note"


def test_errors_beyond_their_sigmas(clean: Result) -> None:
    assert clean.errors is not None
    pos = clean.errors.pos * [1.0, 4.0, 1.0]
    found = the(replace(clean, errors=replace(clean.errors, pos=pos)), "beyond 3 sigma")
    assert found.level == "wrong"
    assert "for east" in found.text
    assert "north " not in found.text
    small = replace(clean, errors=replace(clean.errors, vel=0.05 * clean.errors.vel))
    assert the(small, "its sigmas are").level == "note"


def test_a_reference_is_not_a_judge(clean: Result) -> None:
    assert clean.evidence is not None
    assert clean.errors is not None
    evidence = replace(clean.evidence, truth=None, reference=clean.evidence.truth)
    errors = replace(clean.errors, pos=10.0 * clean.errors.pos)
    spoilt = replace(clean, evidence=evidence, errors=errors)
    assert the(spoilt, "no truth").level == "note"
    assert said(spoilt, "wrong") == []
    nothing = replace(clean, evidence=replace(evidence, reference=None), errors=None)
    assert the(nothing, "no truth").level == "note"


def test_a_yaw_that_is_not_known(clean: Result) -> None:
    spoilt = with_state(clean, "euler", clean.euler, [0.02, 0.02, math.radians(40.0)])
    assert the(spoilt, "yaw is not known").level == "wrong"
    without = {k: v for k, v in clean.innovations.items() if k != "heading"}
    fine = findings(replace(clean, innovations=without))
    assert any("from motion" in f.text and f.level == "fine" for f in fine)


def test_a_large_bias(clean: Result) -> None:
    spoilt = with_state(clean, "b_g", [0.0, -0.05, 0.0])
    found = the(spoilt, "gyro bias y")
    assert "imu.gyro_bias_sigma: 0.05" in found.advice


def test_a_lever_arm_that_is_not_the_one_set(clean: Result) -> None:
    spoilt = with_state(clean, "l_b", [0.8, 0.0, 0.0], 0.05)
    assert "gnss.lever_arm: [0.80, 0.00, 0.00]" in the(spoilt, "antenna lies").advice


def late(result: Result, delay: float) -> Innovations:
    """Velocity innovations of a filter that follows with its gain GNSS velocities that are late."""
    m = result.innovations["gnss_velocity"]
    t = m.t_us * 1e-6
    r = m.innovation.copy()
    gain = 1.0 - (0.1 / 0.11) ** 2
    for i in range(3):
        now, then = (np.interp(t - back, result.seconds, result.v[:, i]) for back in (0.0, delay))
        error = 0.0
        for k in range(len(t)):
            shift = then[k] - now[k] - error
            error += gain * shift
            r[k, i] += shift
    return replace(m, innovation=r)


@pytest.mark.parametrize("delay", [0.12, -0.1, 0.2])
def test_gnss_that_is_late(clean: Result, delay: float) -> None:
    spoilt = replace(clean, innovations=clean.innovations | {"gnss_velocity": late(clean, delay)})
    found = the(spoilt, "lags the IMU" if delay > 0 else "is ahead of the IMU")
    assert found.level == "wrong"
    told = float(found.text.split(" ms")[0].rsplit(" ", 1)[1]) * 1e-3
    assert told == pytest.approx(abs(delay), abs=0.02)
    assert f"gnss.delay: {'-' if delay < 0 else ''}0." in found.advice


def test_a_delay_that_does_not_show(clean: Result) -> None:
    assert the(with_state(clean, "v", 0.0), "does not show").level == "note"


def test_a_delay_that_was_estimated(clean: Result) -> None:
    tau = np.linspace(0.0, 0.18, len(clean))[:, None]
    found = the(with_state(clean, "tau", tau, 0.005), "lags the IMU by 180 ms")
    assert found.level == "note"
    assert "gnss.delay: 0.18" in found.advice
    assert the(with_state(clean, "tau", tau, 0.09), "does not show").level == "note"
    assert said(with_state(clean, "tau", 0.0, 0.005)) == []


@pytest.mark.parametrize(("share", "level"), [(0.02, "note"), (0.2, "wrong")])
def test_rejected_measurements(clean: Result, share: float, level: str) -> None:
    m = clean.innovations["heading"]
    refused = np.arange(len(m)) < share * len(m)
    reason = np.where(refused, "gate", "")
    found = the(with_innovations(clean, "heading", accepted=~refused, reason=reason), "refused")
    assert (found.level, found.figure) == (level, "heading")
    reason = np.where(refused, "few satellites", "")
    found = the(with_innovations(clean, "heading", accepted=~refused, reason=reason), "refused")
    assert found.level == "note"


@pytest.mark.parametrize(
    ("factor", "words", "level"), [(0.1, "smaller", "note"), (3, "larger", "wrong")]
)
def test_innovations_of_another_size(clean: Result, factor: float, words: str, level: str) -> None:
    changes = scaled(clean.innovations["heading"], factor)
    found = the(with_innovations(clean, "heading", **changes), f"{words} than expected")
    assert found.level == level
    assert "heading" in found.text


def test_innovations_that_last(clean: Result) -> None:
    r = clean.innovations["heading"].innovation.copy()
    for k in range(1, len(r)):
        r[k] = 0.8 * r[k - 1] + 0.6 * r[k]
    found = the(with_innovations(clean, "heading", innovation=r), "not white")
    assert "heading 0." in found.text


def test_headings_that_are_biased(clean: Result) -> None:
    r = clean.innovations["heading"].innovation + math.radians(8.0)
    found = the(with_innovations(clean, "heading", innovation=r), "biased by")
    assert found.level == "wrong"
    assert re.search(r"biased by (7\.9|8\.0|8\.1) deg", found.text)
    r = clean.innovations["gnss_position"].innovation + np.array([0.0, 0.0, 0.6])
    assert "down" in the(with_innovations(clean, "gnss_position", innovation=r), "biased").text


def test_accuracies_that_are_not_the_ones_claimed(
    clean: Result, config: Callable[..., Config]
) -> None:
    assert clean.evidence is not None
    told = clean.evidence.gnss.sigmas
    found = the(with_gnss(clean, sigmas=told * [30.0, 1.0, 1.0]), "too large")
    assert found.level == "note"
    assert "horizontal position accuracy of 15 m" in found.text
    assert re.search(r": (29|30|31) x too large", found.text)
    modest = with_gnss(clean, sigmas=told * [1.0, 1.0, 0.2])
    found = the(modest, "too small")
    assert found.level == "wrong"
    assert re.fullmatch(r"Set gnss.velocity_floor: 0\.(09\d|1\d?)", found.advice)
    covered = replace(modest, config=config(**{"gnss.velocity_floor": 0.3}))
    assert the(covered, "which the floor").level == "note"


def test_an_imu_that_is_noisier_than_set(clean: Result, config: Callable[..., Config]) -> None:
    loud = replace(clean, config=config(**{"imu.gyro_noise": 0.001 / 3}))
    found = the(loud, "gyro noise is 3 x its setting")
    assert found.level == "wrong"
    assert "imu.gyro_noise: 0.001" in found.advice
    calm = replace(clean, config=config(**{"imu.accel_noise": 0.5}))
    assert the(calm, "accel noise is set to 25 x").level == "note"


def test_an_imu_that_is_slow_or_has_gaps(clean: Result) -> None:
    assert clean.evidence is not None
    imu = clean.evidence.imu
    slow = np.zeros_like(imu.intervals)
    slow[250] = 40 * 200
    found = the(with_imu(clean, count=np.full(200, 40), intervals=slow), "40 Hz only")
    assert found.level == "note"
    longest = imu.longest_us.copy()
    longest[30] = 1_500_000
    found = the(with_imu(clean, longest_us=longest), "gaps of more than")
    assert "1.50 s at 40 s" in found.text
    holes = imu.intervals.copy()
    holes[100] = 1000
    assert "samples are missing" in the(with_imu(clean, intervals=holes), "2.4 %").text


def test_clipping(clean: Result) -> None:
    clipped = np.zeros(200, dtype=np.int64)
    clipped[[7, 8]] = 3
    assert "6 samples, in 2 seconds" in the(with_imu(clean, clipped=clipped), "at its limit").text


def test_gnss_that_is_silent_or_lost(clean: Result) -> None:
    assert clean.evidence is not None
    gnss = clean.evidence.gnss
    t_us = gnss.t_us.copy()
    t_us[500:] += 5_000_000
    assert the(with_gnss(clean, t_us=t_us), "silent for 5.2 s").level == "wrong"
    t_us[500:] -= 3_800_000
    assert the(with_gnss(clean, t_us=t_us), "silent for 1.4 s").level == "note"
    types = np.where(np.arange(len(t_us)) < 100, 1, 3)
    assert "had no 3-D fix" in the(with_gnss(clean, fix_type=types), "10 %").text
    none = {f.name: getattr(gnss, f.name)[:0] for f in dataclasses.fields(gnss)}
    assert the(with_gnss(clean, **none), "no GNSS").level == "wrong"


def test_a_damaged_log(clean: Result) -> None:
    damage = {"bad_crc": 12, "unknown": 4, "skipped_bytes": 0}
    assert the(with_summary(clean, damage=damage), "damaged").text.endswith("bad crc 12.")


def test_without_evidence_the_rest_is_told(clean: Result) -> None:
    bare = replace(clean, evidence=None, errors=None)
    assert [f.text[:20] for f in said(bare)] == ["The log has no truth"]
