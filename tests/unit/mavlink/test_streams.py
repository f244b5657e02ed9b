"""What is due when, and what is in it."""

from __future__ import annotations

import dataclasses
from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import frame
from mavins.mavlink.settings import StreamSettings
from mavins.mavlink.streams import Home, Streams, estimator_status_of, quality_of, sys_status_of
from mavins.types import Health

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit


def message(payload: Any) -> Any:
    return dialect.MAVLink(None).decode(bytearray(frame(payload, 100, 1, 0)))


def kinds(payloads: Any) -> list[str]:
    return [message(payload).get_type() for payload in payloads]


@pytest.fixture
def home(solution: Any) -> Home:
    return Home.at(solution(1_000_000))


def test_nothing_before_there_is_an_estimate(estimator: Any, home: Home) -> None:
    streams = Streams(StreamSettings())
    assert list(streams.due(estimator, home)) == []
    estimator.t_us = 1_000_000
    estimator.health = Health.ALIGNING
    assert list(streams.due(estimator, home)) == []


def test_each_at_its_rate_on_the_vehicles_clock(estimator: Any, home: Home) -> None:
    settings = StreamSettings()
    streams = Streams(settings)
    estimator.start(7_000_000)
    list(streams.due(estimator, home))
    seen: Counter[str] = Counter()
    for t_us in range(7_004_000, 17_000_001, 4_000):
        estimator.t_us = t_us
        seen.update(kinds(streams.due(estimator, home)))
    for name, rate in dataclasses.asdict(settings).items():
        assert seen[name.upper()] == (0 if name == "sys_status" else round(rate * 10.0)), name


def test_the_first_instant_tells_all_and_so_does_the_first_after_a_reboot(
    estimator: Any, home: Home
) -> None:
    streams = Streams(StreamSettings())
    estimator.start(7_001_000)
    first = kinds(streams.due(estimator, home))
    assert len(first) == len(set(first)) == 9
    assert first[0] == "LOCAL_POSITION_NED"
    estimator.t_us = 7_002_000
    assert kinds(streams.due(estimator, home)) == []
    estimator.t_us = 300_000
    assert kinds(streams.due(estimator, home)) == first


def test_rates_of_zero_turn_a_message_off(estimator: Any, home: Home) -> None:
    names = [f.name for f in dataclasses.fields(StreamSettings)]
    streams = Streams(StreamSettings(**dict.fromkeys(names, 0.0)))
    estimator.start(7_000_000)
    assert list(streams.due(estimator, home)) == []
    assert streams.sys_status_s is None


def test_a_late_sample_does_not_repeat_what_was_sent(estimator: Any, home: Home) -> None:
    streams = Streams(StreamSettings())
    estimator.start(7_000_000)
    list(streams.due(estimator, home))
    assert list(streams.due(estimator, home)) == []


def test_without_a_home_what_counts_from_it_waits(estimator: Any) -> None:
    estimator.start(7_000_000)
    sent = kinds(Streams(StreamSettings()).due(estimator, None))
    assert "HOME_POSITION" not in sent
    assert "GLOBAL_POSITION_INT" not in sent
    assert "ODOMETRY" in sent


def test_home_has_a_heading_and_no_nan(home: Home) -> None:
    sent = message(home.message(9_000_000))
    assert np.linalg.norm(sent.q) == pytest.approx(1.0)
    assert 2.0 * np.arctan2(sent.q[3], sent.q[0]) == pytest.approx(0.5)
    assert (sent.x, sent.y, sent.z) == (10.0, -5.0, -20.0)
    assert sent.time_usec == 9_000_000


@pytest.mark.parametrize(
    ("variance", "health", "quality"),
    [
        (0.01, Health.RUNNING, 100),
        (1.0, Health.RUNNING, 100),
        (4.0, Health.RUNNING, 50),
        (1e8, Health.RUNNING, 1),
        (0.01, Health.DEAD_RECKONING, 1),
    ],
)
def test_quality(variance: float, health: Health, quality: int, solution: Any) -> None:
    one = dataclasses.replace(solution(1, health), P=np.eye(15) * variance)
    assert quality_of(one) == quality


def test_estimator_status_shows_the_latest_test_ratios(estimator: Any) -> None:
    estimator.start(7_000_000)
    estimator.statistics = {
        "gnss_position": SimpleNamespace(last_ratio=0.25),
        "heading": SimpleNamespace(last_ratio=float("nan")),
    }
    sent = message(estimator_status_of(estimator, estimator.solution()))
    assert (sent.pos_horiz_ratio, sent.pos_vert_ratio) == (0.25, 0.25)
    assert sent.mag_ratio == sent.vel_ratio == 0.0
    assert sent.flags == 1 | 2 | 4 | 8 | 16 | 32
    assert sent.pos_horiz_accuracy == pytest.approx(0.2 * 2**0.5)
    estimator.health = Health.DEAD_RECKONING
    assert message(estimator_status_of(estimator, estimator.solution())).flags == 1


def test_sys_status(estimator: Any) -> None:
    gyro, accel, mag, gps, ahrs, fence = 1, 2, 4, 0x20, 0x200000, 0x100000

    def of(gnss_seen: bool, silent: bool = False) -> tuple[int, int]:
        sent = message(sys_status_of(estimator, gnss_seen, silent))
        assert sent.onboard_control_sensors_present == sent.onboard_control_sensors_enabled
        return sent.onboard_control_sensors_present, sent.onboard_control_sensors_health

    assert of(False) == (gyro | accel | mag | ahrs | fence, gyro | accel | fence)
    estimator.start(1)
    everything = gyro | accel | mag | gps | ahrs | fence
    assert of(True) == (everything, everything)
    estimator.health = Health.DEAD_RECKONING
    assert of(True) == (everything, everything & ~gps)
    assert of(True, silent=True) == (everything, fence)
