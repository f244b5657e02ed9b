"""EKF_STATUS_REPORT, EXTENDED_SYS_STATE and VIBRATION as pymavlink reads them."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.estimator.vibration import Vibration
from mavins.mavlink.codec import Payload, frame
from mavins.mavlink.reports import ekf_status_of, extended_sys_state_of, vibration_of
from mavins.types import Health

RUNNING = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512
GLITCH = 32768


def read(payload: Payload | None) -> Any:
    assert payload is not None
    return dialect.MAVLink(None).decode(bytearray(frame(payload, 7, 1, 0)))


def test_ekf_status_has_ratios(make_estimator: Callable[[], Any]) -> None:
    estimator = make_estimator()
    assert read(ekf_status_of(estimator)).flags == dialect.EKF_UNINITIALIZED
    estimator.start(1_000_000)
    for name, ratio in (("gnss_position", 0.4), ("gnss_velocity", 0.2), ("heading", 0.7)):
        estimator.statistics[name] = SimpleNamespace(last_ratio=ratio)
    message = read(ekf_status_of(estimator))
    assert message.flags == RUNNING
    found = (message.velocity_variance, message.pos_horiz_variance, message.pos_vert_variance)
    assert found == pytest.approx((0.2, 0.4, 0.4))
    assert message.compass_variance == pytest.approx(0.7)
    estimator.statistics["gnss_position"].last_ratio = 1.3
    assert read(ekf_status_of(estimator)).flags == RUNNING | GLITCH
    estimator.statistics["gnss_position"].last_ratio = float("nan")
    assert read(ekf_status_of(estimator)).pos_horiz_variance == 0.0
    estimator.health = Health.DEAD_RECKONING
    assert read(ekf_status_of(estimator)).flags == dialect.EKF_ATTITUDE


@pytest.mark.parametrize(("standing", "state"), [(None, 0), (True, 1), (False, 2)])
def test_landed_state(standing: bool | None, state: int) -> None:
    estimator: Any = SimpleNamespace(standing=standing)
    message = read(extended_sys_state_of(estimator))
    assert (message.landed_state, message.vtol_state) == (state, 0)


def test_vibration() -> None:
    times = np.arange(1, 501, dtype=np.int64) * 4000
    imu = np.zeros((500, 6))
    imu[::2, 3] = 10.0
    imu[7, 4] = 200.0
    shaken: Any = SimpleNamespace(t_us=2_000_000, imu_after=lambda t_us: (times, imu))
    message = read(vibration_of(shaken, Vibration()))
    assert message.time_usec == 2_000_000
    assert message.vibration_x == pytest.approx(5.0, rel=0.1)
    assert message.vibration_z == 0.0
    assert (message.clipping_0, message.clipping_1, message.clipping_2) == (1, 0, 0)
    nothing: Any = SimpleNamespace(t_us=None)
    assert vibration_of(nothing, Vibration()) is None
