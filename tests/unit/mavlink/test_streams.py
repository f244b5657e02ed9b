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
from mavins.mavlink.settings import AS_VEHICLE, StreamSettings
from mavins.mavlink.streams import (
    OF_ESTIMATE,
    OF_SERVICE,
    Home,
    Plan,
    Telemetry,
    estimator_status_of,
    plan_of,
    quality_of,
    sys_status_of,
)
from mavins.types import Health

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit


def message(payload: Any) -> Any:
    return dialect.MAVLink(None).decode(bytearray(frame(payload, 100, 1, 0)))


class OneVehicle:
    """As much of a vehicle as messages tell of."""

    def __init__(self, estimator: Any, home: Home | None) -> None:
        self.estimator = estimator
        self.home = home
        clock = SimpleNamespace(unix_of=lambda t_us: t_us + 10**15)
        self.intake: Any = SimpleNamespace(last_fix=None, clock=clock)
        self.vibration: Any = SimpleNamespace(level=np.zeros(3), clipped=0, look=lambda e: None)
        self.silent = self.alarm = False


@pytest.fixture
def home(solution: Any) -> Home:
    return Home.at(solution(1_000_000))


@pytest.fixture
def usual() -> Plan:
    return plan_of(StreamSettings().rates("vehicle"), OF_ESTIMATE)


def test_each_at_its_rate(usual: Plan) -> None:
    usual.due(7_000_000)
    seen: Counter[str] = Counter()
    for t_us in range(7_004_000, 17_000_001, 4_000):
        seen.update(usual.due(t_us))
    for name in OF_ESTIMATE:
        assert seen[name] == round(AS_VEHICLE.get(name, 0.0) * 10.0), name


def test_the_first_instant_tells_all_and_so_does_the_first_after_a_reboot(usual: Plan) -> None:
    first = usual.due(7_001_000)
    assert first[0] == "local_position_ned"
    assert usual.due(7_002_000) == []
    assert usual.due(300_000) == first


def test_rates_of_zero_turn_a_message_off() -> None:
    names = [f.name for f in dataclasses.fields(StreamSettings)]
    rates = StreamSettings(**dict.fromkeys(names, 0.0)).rates("vehicle")
    assert plan_of(rates, OF_ESTIMATE).due(7_000_000) == []


def test_a_late_sample_does_not_repeat_what_was_sent(usual: Plan) -> None:
    usual.due(7_000_000)
    assert usual.due(7_000_000) == []


def test_a_plan_with_another_period_leaves_the_first_alone(usual: Plan) -> None:
    usual.due(7_000_000)
    other = usual.changed("attitude", 500_000).changed("odometry", -1)
    assert "odometry" not in other.period_us
    assert other.due(7_400_000).count("attitude") == 0
    assert "attitude" in other.due(7_500_000)
    assert usual.period_us["attitude"] == 20_000


def test_every_message_is_made_and_named_as_it_is_called(estimator: Any, home: Home) -> None:
    estimator.start(7_000_000)
    telemetry = Telemetry(OneVehicle(estimator, home))
    for name in (*OF_ESTIMATE, *OF_SERVICE):
        payload = telemetry[name]
        assert payload is not None, name
        assert message(payload).get_type() == name.upper()
        assert telemetry[name] is payload


def test_nothing_of_an_estimate_before_there_is_one(estimator: Any, home: Home) -> None:
    telemetry = Telemetry(OneVehicle(estimator, home))
    assert all(telemetry[name] is None for name in OF_ESTIMATE)
    assert telemetry["sys_status"] is not None


def test_without_a_home_what_counts_from_it_waits(estimator: Any) -> None:
    estimator.start(7_000_000)
    telemetry = Telemetry(OneVehicle(estimator, None))
    assert telemetry["home_position"] is telemetry["global_position_int"] is None
    assert telemetry["odometry"] is not None


def test_every_rate_belongs_to_a_message() -> None:
    named = {f.name for f in dataclasses.fields(StreamSettings)}
    assert named == {*OF_ESTIMATE, *OF_SERVICE}


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
    gyro, accel, mag, gps, ahrs, fence, check = 1, 2, 4, 0x20, 0x200000, 0x100000, 0x10000000

    def of(gnss_seen: bool, silent: bool = False, alarm: bool = False) -> tuple[int, int]:
        sent = message(sys_status_of(estimator, gnss_seen, silent, alarm))
        assert sent.onboard_control_sensors_present == sent.onboard_control_sensors_enabled
        return sent.onboard_control_sensors_present, sent.onboard_control_sensors_health

    known = gyro | accel | mag | ahrs | fence | check
    assert of(False) == (known, gyro | accel | fence | check)
    estimator.start(1)
    everything = known | gps
    assert of(True, alarm=True) == (everything, everything & ~check)
    assert of(True) == (everything, everything)
    estimator.health = Health.DEAD_RECKONING
    assert of(True) == (everything, everything & ~gps)
    assert of(True, silent=True) == (everything, fence | check)
