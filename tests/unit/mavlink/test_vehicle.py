"""What a session says about one vehicle by its own accord: health, resets, fixes, silence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import frame, heartbeat, highres_imu, scan
from mavins.mavlink.intake import Intake
from mavins.mavlink.peers import Identity
from mavins.mavlink.settings import StreamSettings
from mavins.mavlink.sources import SourceSettings
from mavins.mavlink.vehicle import REASON_US, Holder, Vehicle
from mavins.types import GnssFix, Health, ImuSample, Origin

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

START_US = 1_790_000_000_000_000


class Watched:
    """A vehicle, its estimator's stand-in, and what was said."""

    def __init__(self, estimator: Any) -> None:
        self.estimator = estimator
        intake = Intake(estimator, SourceSettings())
        self.vehicle = Vehicle(
            7,
            Identity(106, 1),
            estimator,
            intake,
            Holder("there", START_US),
            StreamSettings(),
            3_000_000,
        )
        self.now_us = START_US

    def packets(self, *payloads: Any) -> list[Any]:
        """Packets come in now."""
        self.vehicle.holder.seen_us = self.now_us
        data = b"".join(frame(payload, 7, 1, 0) for payload in payloads)
        return self._said(self.vehicle.take(scan(data, self.now_us)))

    def imu(self, t_us: int) -> list[Any]:
        return self.packets(highres_imu(ImuSample(t_us, np.array([0, 0, -9.8]), np.zeros(3))))

    def tick(self, after_us: int = 0) -> list[Any]:
        self.now_us += after_us
        return self._said(self.vehicle.tick(self.now_us))

    def _said(self, payloads: Any) -> list[Any]:
        link = dialect.MAVLink(None)
        return [link.decode(bytearray(frame(p, 106, 1, 0))) for p in payloads]


def of(kind: str, said: list[Any]) -> list[Any]:
    return [message for message in said if message.get_type() == kind]


def texts(said: list[Any]) -> str:
    return "".join(message.text for message in of("STATUSTEXT", said))


@pytest.fixture
def watched(estimator: Any) -> Watched:
    return Watched(estimator)


def test_heartbeat_once_a_second(watched: Watched) -> None:
    said = [message for _ in range(100) for message in watched.tick(50_000)]
    assert len(of("HEARTBEAT", said)) == 5
    beat = of("HEARTBEAT", said)[0]
    assert (beat.type, beat.autopilot) == (0, 0)


@pytest.mark.parametrize(
    ("health", "state"),
    [
        (Health.WAITING, 1),
        (Health.ALIGNING, 2),
        (Health.RUNNING, 4),
        (Health.DEAD_RECKONING, 5),
        (Health.DIVERGED, 5),
    ],
)
def test_the_heartbeat_tells_of_health(health: Health, state: int, watched: Watched) -> None:
    watched.estimator.health = health
    assert of("HEARTBEAT", watched.tick())[0].system_status == state


def test_a_text_for_each_change_of_health_and_each_reset(watched: Watched) -> None:
    watched.estimator.health = Health.ALIGNING
    watched.estimator.reason = "no heading source"
    assert texts(watched.imu(1_000_000)) == "mavins aligning: no heading source"
    assert texts(watched.imu(1_004_000)) == ""
    watched.estimator.start(1_008_000)
    said = watched.imu(1_008_000)
    assert texts(said) == "mavins running"
    assert of("STATUSTEXT", said)[0].severity == 6
    watched.estimator.reset_counter = 1
    said = watched.imu(1_012_000)
    assert texts(said) == "mavins estimate reset (1)"
    assert of("STATUSTEXT", said)[0].severity == 4
    watched.estimator.health = Health.DEAD_RECKONING
    watched.estimator.reason = "no GNSS accepted for 3 s"
    assert texts(watched.imu(1_016_000)) == "mavins dead reckoning: no GNSS accepted for 3 s"


def test_why_an_estimate_was_lost(watched: Watched) -> None:
    watched.estimator.start(1_000_000)
    watched.imu(1_000_000)
    watched.estimator.realignments = 1
    watched.estimator.loss = "IMU gap of 4.0 s"
    assert texts(watched.imu(5_000_000)) == "mavins estimate lost: IMU gap of 4.0 s"


def test_what_is_lacking_is_said_once_it_has_lasted(watched: Watched) -> None:
    watched.estimator.health = Health.ALIGNING
    watched.estimator.reason = "GNSS: 1 of 3 good fixes"
    watched.imu(1_000_000)
    watched.estimator.reason = "no heading source"
    assert texts(watched.tick(100_000)) == ""
    watched.imu(1_100_000)
    assert texts(watched.tick(REASON_US)) == "mavins aligning: no heading source"
    watched.imu(1_200_000)
    assert texts(watched.tick(REASON_US)) == ""


def test_silence_is_noticed_and_so_is_the_return(watched: Watched) -> None:
    watched.estimator.start(1_000_000)
    watched.imu(1_000_000)
    assert texts(watched.tick(2_900_000)) == ""
    said = watched.tick(1_200_000)
    assert texts(said) == "mavins: vehicle 7 silent"
    assert of("HEARTBEAT", said)[0].system_status == 5
    assert texts(watched.tick(5_000_000)) == ""
    assert watched.vehicle.silence(watched.now_us) == "silent for 9 s"
    watched.imu(1_004_000)
    said = watched.tick(1_000_000)
    assert texts(said) == "mavins: vehicle 7 is back"
    assert of("HEARTBEAT", said)[0].system_status == 4


def test_heartbeats_without_an_imu_are_not_enough(watched: Watched) -> None:
    watched.imu(1_000_000)
    for _ in range(4):
        watched.now_us += 1_000_000
        watched.packets(heartbeat(2, 0))
    assert watched.vehicle.silence(watched.now_us) == "no usable IMU for 4 s"
    assert texts(watched.tick()) == "mavins: vehicle 7 no usable IMU"


def test_each_fix_is_passed_on_once_while_there_is_an_estimate(watched: Watched) -> None:
    fix = GnssFix(1, 0.8, 0.1, 400.0, None, 3, 9)
    watched.vehicle.intake.fixes.last = fix
    assert of("GPS_RAW_INT", watched.imu(1_000_000)) == []
    watched.estimator.start(1_004_000)
    watched.vehicle.intake.fixes.last = GnssFix(2, 0.8, 0.1, 400.0, None, 3, 9)
    assert len(of("GPS_RAW_INT", watched.imu(1_004_000))) == 1
    assert of("GPS_RAW_INT", watched.imu(1_008_000)) == []


def test_home_is_where_the_first_estimate_was(watched: Watched) -> None:
    assert watched.vehicle.welcome() == []
    watched.estimator.start(1_000_000)
    watched.imu(1_000_000)
    (home,) = watched._said(watched.vehicle.welcome())
    assert (home.x, home.y, home.z) == (10.0, -5.0, -20.0)


def test_a_new_origin_is_announced_and_home_found_anew(watched: Watched) -> None:
    watched.estimator.start(1_000_000)
    watched.imu(1_000_000)
    before = watched.vehicle.home
    origin = Origin(0.8, 0.1, 300.0)
    said = watched._said(watched.vehicle.set_origin(origin))
    assert watched.estimator.origins == [origin]
    assert of("GPS_GLOBAL_ORIGIN", said)[0].altitude == 300_000
    assert watched.vehicle.home is not before
