"""Trouble of a real flight: GNSS lost, frozen or elsewhere, reboots, silence; what the service says and does."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest

from mavins.config import load
from mavins.types import Health

pytestmark = pytest.mark.jit

GYRO_ACCEL, AHRS, GPS = 0x03, 0x200000, 0x20
CRITICAL, ACTIVE = 5, 4


def moved(metres_north: float) -> float:
    return metres_north / 6_371_000.0


def test_no_fix_with_plausible_numbers(rig: Any, standing: Callable[..., Any]) -> None:
    """With the GNSS lost the messages go on: none of them is used, the estimate is dead reckoning and says so."""
    vehicle = standing()
    rig.run(vehicle.packets(6.0))
    estimator = rig.vehicle().estimator
    accepted = estimator.statistics["gnss_position"].accepted
    vehicle.fix_type = 1
    vehicle.lat += moved(3.0)
    rig.run(vehicle.packets(5.0))
    assert estimator.health == Health.DEAD_RECKONING
    assert estimator.statistics["gnss_position"].accepted <= accepted + 6
    assert estimator.statistics["gnss_position"].rejected["no 3D fix"] >= 19
    assert any("dead reckoning: no GNSS accepted" in text for text in rig.texts())
    assert rig.messages("HEARTBEAT")[-1].system_status == CRITICAL
    assert not rig.messages("SYS_STATUS")[-1].onboard_control_sensors_health & GPS
    assert rig.messages("GPS_RAW_INT")[-1].fix_type == 1
    assert estimator.solution().P[0, 0] > 0.0
    assert abs(estimator.solution().p_n[0]) < 1.0
    vehicle.fix_type = 3
    vehicle.lat = vehicle.LAT
    rig.run(vehicle.packets(3.0))
    assert estimator.health == Health.RUNNING
    assert estimator.reset_counter == 0
    assert rig.messages("HEARTBEAT")[-1].system_status == ACTIVE


def test_no_start_without_a_fix(rig: Any, standing: Callable[..., Any]) -> None:
    vehicle = standing()
    vehicle.fix_type = 2
    rig.run(vehicle.packets(6.0))
    assert not rig.vehicle().estimator.running
    assert "no 3D fix" in rig.vehicle().estimator.reason
    for kind in (
        "LOCAL_POSITION_NED",
        "ATTITUDE",
        "ODOMETRY",
        "GPS_GLOBAL_ORIGIN",
        "HOME_POSITION",
    ):
        assert not rig.messages(kind), kind
    assert len(rig.messages("HEARTBEAT")) >= 6


def test_a_frozen_stamp_is_one_fix(rig: Any, standing: Callable[..., Any]) -> None:
    vehicle = standing()
    rig.run(vehicle.packets(6.0))
    accepted = rig.vehicle().estimator.statistics["gnss_position"].accepted
    vehicle.fix_stamp = vehicle.t_us
    vehicle.lat += moved(1.0)
    rig.run(vehicle.packets(4.0))
    assert rig.vehicle().intake.dropped["GLOBAL_POSITION_INT repeated stamp"] == 19
    assert rig.vehicle().estimator.statistics["gnss_position"].accepted <= accepted + 7
    assert rig.vehicle().estimator.health == Health.DEAD_RECKONING


def test_position_zero_zero_is_nowhere(rig: Any, standing: Callable[..., Any]) -> None:
    vehicle = standing()
    vehicle.lat = vehicle.lon = 0.0
    rig.run(vehicle.packets(4.0))
    dropped = rig.vehicle().intake.dropped
    assert dropped["GPS_RAW_INT position 0/0"] == 20
    assert dropped["GLOBAL_POSITION_INT position 0/0"] == 20
    assert not rig.vehicle().estimator.running
    vehicle.lat, vehicle.lon = vehicle.LAT, vehicle.LON
    rig.run(vehicle.packets(4.0))
    assert rig.vehicle().estimator.running
    assert rig.messages("GPS_GLOBAL_ORIGIN")[-1].latitude == pytest.approx(474000000, abs=2)
    vehicle.lat = vehicle.lon = 0.0
    rig.run(vehicle.packets(1.0))
    assert dropped["GLOBAL_POSITION_INT position 0/0"] == 25
    assert abs(rig.vehicle().estimator.solution().p_n[0]) < 1.0


@pytest.mark.parametrize("heading", ["attitude", "off"])
def test_a_jump_of_100_km_is_rejected_and_then_believed(
    heading: str, make_rig: Callable[..., Any], standing: Callable[..., Any]
) -> None:
    rig = make_rig(load(None, {"zero_velocity.enabled": heading != "off"}))
    vehicle = standing()
    rig.run(vehicle.packets(6.0))
    estimator = rig.vehicle().estimator
    jumped_us = vehicle.t_us
    vehicle.lat += moved(100_000.0)
    rig.run(vehicle.packets(6.5))
    assert estimator.reset_counter == 0
    assert abs(estimator.solution().p_n[0]) < 5.0
    assert estimator.statistics["gnss_position"].rejected["gate"] >= 25
    rig.run(vehicle.packets(3.0))
    assert estimator.reset_counter == 1
    assert estimator.realignments == 0
    assert estimator.health == Health.RUNNING
    assert estimator.solution().lat == pytest.approx(vehicle.lat, abs=1e-6)
    assert sum("estimate reset (1)" in text for text in rig.texts()) == 1
    odometry = rig.messages("ODOMETRY")
    assert {m.reset_counter for m in odometry} == {0, 1}
    first = next(m for m in odometry if m.reset_counter == 1)
    assert 6.9e6 < first.time_usec - jumped_us < 7.6e6
    # in the tangent frame of the old origin: 100 km away and below its plane
    assert odometry[-1].x == pytest.approx(1e5, rel=0.01)
    assert rig.messages("LOCAL_POSITION_NED")[-1].z == pytest.approx(784.0, rel=0.03)
    rig.close()


def test_a_reboot_in_flight(rig: Any, standing: Callable[..., Any]) -> None:
    before = standing(boot_us=300_000_000)
    rig.run(before.packets(6.0))
    estimator = rig.vehicle().estimator
    origin = estimator.frame.origin
    assert rig.messages("LOCAL_POSITION_NED")[-1].time_boot_ms > 305_000
    rebooted_at = len(rig.sent)
    after = standing(boot_us=500_000)
    after.unix_us = rig.now_us + 2_000_000 - after.t_us
    after.yaw = 1.0
    rig.run(after.packets(6.0))
    assert rig.vehicle().intake.reboots == 1
    assert estimator.health == Health.RUNNING
    assert estimator.reset_counter == 1
    assert estimator.frame.origin == origin
    assert any("estimate lost: the vehicle has rebooted" in text for text in rig.texts())
    new = [m for _, _, m in rig.sent[rebooted_at:] if m.get_type() == "LOCAL_POSITION_NED"]
    assert new
    assert all(m.time_boot_ms < 7_000 for m in new)
    assert rig.messages("ATTITUDE")[-1].yaw == pytest.approx(1.0, abs=0.05)


def test_a_vehicle_that_falls_silent_and_comes_back(rig: Any, standing: Callable[..., Any]) -> None:
    vehicle = standing()
    rig.run(vehicle.packets(6.0))
    silent_from = rig.now_us
    rig.wait(silent_from + 2_900_000)
    assert "mavins: vehicle 1 silent" not in rig.texts()
    assert rig.messages("HEARTBEAT")[-1].system_status == ACTIVE
    estimates = len(rig.messages("LOCAL_POSITION_NED"))
    rig.wait(silent_from + 6_000_000)
    assert rig.texts().count("mavins: vehicle 1 silent") == 1
    assert len(rig.messages("LOCAL_POSITION_NED")) == estimates
    last = rig.messages("HEARTBEAT")[-1]
    assert last.system_status == CRITICAL
    health = rig.messages("SYS_STATUS")[-1].onboard_control_sensors_health
    assert not health & (GYRO_ACCEL | AHRS | GPS)
    assert rig.vehicle().silence(rig.now_us) == "silent for 6 s"
    vehicle.unix_us += 6_000_000
    vehicle.t_us += 0
    rig.run(vehicle.packets(5.0))
    assert rig.texts().count("mavins: vehicle 1 is back") == 1
    assert rig.vehicle().silence(rig.now_us) == ""
    assert rig.messages("HEARTBEAT")[-1].system_status == ACTIVE
    health = rig.messages("SYS_STATUS")[-1].onboard_control_sensors_health
    assert health & GPS
    assert health & GYRO_ACCEL == GYRO_ACCEL


def test_a_vehicle_whose_imu_stops(rig: Any, standing: Callable[..., Any]) -> None:
    vehicle = standing()
    rig.run(vehicle.packets(6.0))
    for item in vehicle.packets(5.0):
        if int.from_bytes(item[2][7:10], "little") != 105:
            rig.receive(*item)
    assert rig.texts().count("mavins: vehicle 1 no usable IMU") == 1
    assert "mavins: vehicle 1 silent" not in rig.texts()
    assert rig.messages("HEARTBEAT")[-1].system_status == CRITICAL
    rig.run(vehicle.packets(4.0))
    assert rig.texts().count("mavins: vehicle 1 is back") == 1
    assert rig.messages("HEARTBEAT")[-1].system_status == ACTIVE


def test_the_live_status_says_that_it_is_silent(
    rig: Any, standing: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.run(standing().packets(5.0))
    monkeypatch.setattr(rig.service, "_now_us", lambda: rig.now_us + 4_200_000)
    snapshot = rig.service.snapshot(5.0)
    assert snapshot.vehicles[0].reason == "silent for 4 s"
    monkeypatch.setattr(rig.service, "_now_us", lambda: rig.now_us)
    assert rig.service.snapshot(6.0).vehicles[0].reason == ""


def test_without_a_heading_it_stays_aligning(rig: Any, standing: Callable[..., Any]) -> None:
    for item in standing().packets(5.0):
        if int.from_bytes(item[2][7:10], "little") != 30:
            rig.receive(*item)
    estimator = rig.vehicle().estimator
    assert estimator.health == Health.ALIGNING
    assert estimator.reason == "no heading source: waiting for motion"
    assert any("aligning: no heading source" in text for text in rig.texts())


def test_peers_expire_and_come_back(
    make_rig: Callable[..., Any], standing: Callable[..., Any]
) -> None:
    from mavins.mavlink.codec import frame, heartbeat

    peer = (0, "127.0.0.1", 40_002)
    named = (0, "127.0.0.1", 40_005)
    rig = make_rig(load(None, {"mavlink.peer_timeout": 2.0}))
    rig.session.add_peer(named)
    vehicle = standing()
    rig.run(vehicle.packets(5.0))
    rig.receive(rig.now_us, peer, frame(heartbeat(6, 8), 255, 190, 0))
    # what comes seldom is told to a new peer at once
    assert next(m for _, to, m in rig.sent if to == peer).get_type() == "HOME_POSITION"
    joined = rig.now_us
    rig.run(vehicle.packets(5.0))
    heard = [t for t, to, _ in rig.sent if to == peer]
    assert max(heard) - joined == pytest.approx(2e6, abs=1e5)
    assert set(rig.session.peers) == {named, vehicle.address}
    rig.receive(rig.now_us, peer, frame(heartbeat(6, 8), 255, 190, 1))
    rig.run(vehicle.packets(1.0))
    numbers = [m.get_seq() for _, to, m in rig.sent if to == named]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))
    assert len(rig.messages("ATTITUDE", named)) == len(rig.messages("ATTITUDE", vehicle.address))
    assert math.isclose(len(rig.messages("ATTITUDE", peer)), 150, abs_tol=15)
    rig.close()
