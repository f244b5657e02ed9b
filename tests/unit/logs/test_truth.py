"""The truth in a log: of our simulator, and of both recordings as their README describes them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavins.logs.tlog import read_tlog
from mavins.logs.truth import truth_of
from mavins.mavlink.codec import fields_of, frame, hil_state_quaternion, payload, scan
from mavins.types import TruthSample


def test_hil_state_quaternion() -> None:
    samples = [
        TruthSample(20_000 * k, 0.8, 0.15, 500.0 + k, (1.0, 2.0, -0.5), (0.6, 0.0, 0.8, 0.0))
        for k in (1, 2, 2, 4, 3)
    ]
    packets = [frame(hil_state_quaternion(s, (0, 0, 0), (0, 0, 0)), 7, 1, 0) for s in samples]
    frames = scan(b"".join(packets))
    truth = truth_of(frames, 7)
    assert truth is not None
    assert truth.source == "HIL_STATE_QUATERNION"
    assert truth.t_us.tolist() == [20_000, 40_000, 60_000, 80_000]
    assert truth.lla[:, 2].tolist() == [501.0, 502.0, 503.0, 504.0]
    assert truth.v_l[0] == pytest.approx([1.0, 2.0, -0.5])
    assert truth.q_lb[0] == pytest.approx([0.6, 0.0, 0.8, 0.0])
    assert truth_of(frames, 1) is None


def test_sim_state_takes_the_stamp_of_the_raw_imu_before_it() -> None:
    raw, sim = fields_of("RAW_IMU"), fields_of("SIM_STATE")

    def state(lat_e7: int) -> bytes:
        return frame(payload(sim, q1=1.0, alt=5.0, lat_int=lat_e7, lon_int=1), 1, 1, 0)

    def imu(t_us: int, sysid: int = 1) -> bytes:
        return frame(payload(raw, time_usec=t_us), sysid, 1, 0)

    frames = scan(
        state(10) + imu(1000) + state(20) + imu(5000, 2) + state(30) + imu(2000) + state(40)
    )
    truth = truth_of(frames, 1)
    assert truth is not None
    assert truth.t_us.tolist() == [1000, 2000]  # one row for one stamp, none without
    assert np.degrees(truth.lla[:, 0]) * 1e7 == pytest.approx([20, 40])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "sysid", "source", "home"),
    [
        ("px4_quad_mission", 8, "HIL_STATE_QUATERNION", (47.3977432, 8.5455944, 489.4)),
        ("ap_copter_square_circle", 1, "SIM_STATE", (-35.363262, 149.165237, 584.0)),
    ],
)
def test_recordings(
    shared: Callable[[str], Path], name: str, sysid: int, source: str, home: tuple[float, ...]
) -> None:
    truth = truth_of(read_tlog(shared(f"recordings/{name}.tlog.xz")), sysid)
    assert truth is not None
    assert truth.source == source
    assert len(truth) > 10_000
    assert (np.diff(truth.t_us) > 0).all()
    assert math.degrees(truth.lla[0, 0]) == pytest.approx(home[0], abs=1e-5)
    assert math.degrees(truth.lla[0, 1]) == pytest.approx(home[1], abs=1e-5)
    assert truth.lla[0, 2] == pytest.approx(home[2], abs=0.5)
    assert abs(np.linalg.norm(truth.q_lb, axis=1) - 1.0).max() < 1e-12
