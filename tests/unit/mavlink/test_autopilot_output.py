"""What is due to an autopilot, which one takes what, and on whose clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.autopilot_output import AutopilotOutput
from mavins.mavlink.autopilot_settings import AutopilotOutputSettings
from mavins.mavlink.clock import Clock
from mavins.mavlink.codec import Payload, frame

GENERIC, ARDUPILOT, PX4 = 0, 3, 12
NEW_YEAR_2020_US = 1_577_836_800_000_000


def read(payload: Payload) -> Any:
    return dialect.MAVLink(None).decode(bytearray(frame(payload, 1, 191, 0)))


def clock_at(t_us: int, unix_us: int | None = None, lag_us: int = 0) -> Clock:
    clock = Clock()
    clock.map_imu(np.array([t_us]), np.array([t_us + lag_us]))
    clock.system_time(unix_us, t_us)
    return clock


def output(clock: Clock | None = None, **settings: Any) -> AutopilotOutput:
    return AutopilotOutput(AutopilotOutputSettings(**settings), clock or Clock())


def test_off_by_default(make_estimator: Callable[[], Any]) -> None:
    estimator = make_estimator()
    estimator.start(1_000_000)
    assert not list(output().due(estimator, PX4))
    assert output().refusal(GENERIC) == ""


@pytest.mark.parametrize(("autopilot", "frame_id"), [(PX4, 1), (ARDUPILOT, 20)])
def test_odometry_in_the_frame_that_the_autopilot_reads(
    autopilot: int, frame_id: int, make_estimator: Callable[[], Any]
) -> None:
    estimator = make_estimator()
    estimator.start(1_000_000)
    clock = clock_at(1_000_000, lag_us=NEW_YEAR_2020_US)
    (payload,) = output(clock, output="odometry").due(estimator, autopilot)
    message = read(payload)
    assert (message.get_type(), message.frame_id, message.estimator_type) == (
        "ODOMETRY",
        frame_id,
        3,
    )
    assert message.time_usec == NEW_YEAR_2020_US + 1_000_000, "what TIMESYNC tells"


def test_the_rate_is_kept_on_the_vehicles_clock(make_estimator: Callable[[], Any]) -> None:
    estimator = make_estimator()
    due = output(output="vision_position_estimate", rate=20.0)
    sent = 0
    for t_us in range(1_000_000, 3_000_000, 4_000):
        estimator.start(t_us)
        sent += len(list(due.due(estimator, PX4)))
    assert sent == 40
    estimator.start(1_000)  # a reboot does not stop it
    assert len(list(due.due(estimator, PX4))) == 1


def test_nothing_without_an_estimate_or_an_autopilot(make_estimator: Callable[[], Any]) -> None:
    estimator = make_estimator()
    due = output(output="odometry")
    assert not list(due.due(estimator, PX4))
    estimator.start(1_000_000)
    assert not list(due.due(estimator, None))
    assert not list(due.due(estimator, GENERIC))
    assert "neither PX4 nor ArduPilot" in due.refusal(GENERIC)


def test_gps_input_is_for_ardupilot_and_waits_for_utc(make_estimator: Callable[[], Any]) -> None:
    estimator = make_estimator()
    estimator.start(1_000_000)
    early = output(clock_at(1_000_000), output="gps_input")
    assert not list(early.due(estimator, ARDUPILOT))
    assert "UTC" in early.refusal(ARDUPILOT)
    due = output(clock_at(1_000_000, NEW_YEAR_2020_US), output="gps_input", gps_id=1)
    assert not list(due.due(estimator, PX4))
    assert due.refusal(PX4) == "only ArduPilot takes GPS_INPUT"
    assert due.refusal(ARDUPILOT) == ""
    message = read(next(due.due(estimator, ARDUPILOT, satellites=11)))
    assert (message.gps_id, message.time_week, message.time_week_ms) == (1, 2086, 259_218_000)
    assert message.satellites_visible == 11
