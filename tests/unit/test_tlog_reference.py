"""The autopilot's own word in telemetry: only of a filter, on the boot clock, between positions not too far apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Frames, scan
from mavins.mavlink.sources import ARDUPILOT
from mavins.nav.so3 import quat_to_euler
from mavins.tlog_reference import AutopilotReference

GENERIC = 0


def packets(autopilot: int, compid: int = 1) -> list[bytes]:
    """Two seconds: attitude at 10 Hz, positions at 5 Hz but for a hole from 1.0 to 1.6 s; north at 10 m/s."""
    link = dialect.MAVLink(None, 7, compid)
    made = [
        link.heartbeat_encode(2, autopilot, 0, 0, 4),
        link.raw_imu_encode(1_000_000, 0, 0, -1000, 0, 0, 0, 0, 0, 0),
    ]
    for k in range(21):
        ms = 1000 + 100 * k
        made.append(link.attitude_encode(ms, 0.1, -0.2, 3.0, 0.0, 0.0, 0.0))
        if k % 2 == 0 and not 10 < k < 16:
            lat = round((47.0 + math.degrees(k / 6.37e6)) * 1e7)
            made.append(
                link.global_position_int_encode(ms, lat, 80000000, 500000, 0, 1000, 0, -200, 0)
            )
    return [message.pack(link) for message in made]


def frames_of(data: list[bytes]) -> Frames:
    return scan(b"".join(data))


def test_an_autopilot_with_a_filter() -> None:
    data = packets(ARDUPILOT)
    reference = AutopilotReference()
    for part in (data[:9], data[9:]):  # a log comes in blocks
        reference.see(frames_of(part), 7)
    truth = reference.truth()
    assert truth is not None
    assert truth.source == "autopilot"
    assert truth.t_us.tolist() == [1_000_000 + 100_000 * k for k in range(21)]
    assert_allclose(quat_to_euler(truth.q_lb[5]), [0.1, -0.2, 3.0], atol=1e-6)
    known = np.isfinite(truth.lla).all(axis=1)
    assert np.flatnonzero(~known).tolist() == [10, 11, 12, 13, 14, 15]
    assert_allclose(
        truth.lla[known, 0], np.radians(47.0) + np.flatnonzero(known) / 6.37e6, atol=2e-9
    )
    assert_allclose(truth.v_l[known], [[10.0, 0.0, -2.0]] * 15, atol=1e-9)


@pytest.mark.parametrize(
    "data",
    [packets(GENERIC), packets(ARDUPILOT)[:1], packets(ARDUPILOT)[:4], []],
    ids=["sensors", "no imu", "short", "nothing"],
)
def test_where_there_is_none(data: list[bytes]) -> None:
    reference = AutopilotReference()
    if data:
        reference.see(frames_of(data), 7)
    assert reference.truth() is None


def test_others_are_not_asked() -> None:
    reference = AutopilotReference()
    reference.see(frames_of([*packets(GENERIC), *packets(ARDUPILOT, compid=9)]), 7)
    assert reference.truth() is None
    reference.see(frames_of(packets(ARDUPILOT)), 8)
    assert reference.truth() is None
