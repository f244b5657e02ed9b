"""What a log holds, of made-up logs with known contents and of both recordings."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavins.errors import LogFormatError
from mavins.logs.inspect import choose_system, imu_systems, inspect
from mavins.logs.tlog import read_tlog
from mavins.mavlink.codec import (
    Frames,
    Payload,
    fields_of,
    frame,
    gps_raw_int,
    heartbeat,
    highres_imu,
    hil_state_quaternion,
    payload,
    scan_tlog,
)
from mavins.types import GnssFix, ImuSample, TruthSample

T0 = 1_750_000_000_000_000


def imu(t_us: int) -> Payload:
    return highres_imu(ImuSample(t_us, np.array([0.0, 0.0, -9.8]), np.zeros(3)))


def log(*records: tuple[int, int, Payload]) -> Frames:
    """A tlog of (boot microseconds of reception, sysid, payload)."""
    data = [
        (T0 + at).to_bytes(8, "big") + frame(message, sysid, 1, k)
        for k, (at, sysid, message) in enumerate(records)
    ]
    return scan_tlog(b"".join(data))


def flight(sysid: int = 3, autopilot: int = 12) -> list[tuple[int, int, Payload]]:
    records = [(0, sysid, heartbeat(2, autopilot))]
    records += [(t, sysid, imu(1_000_000 + t)) for t in range(0, 2_000_000, 4000)]
    return records


def test_vehicle_imu_and_sources() -> None:
    report = inspect(log(*flight()))
    assert (report.packets, report.duration) == (501, pytest.approx(1.996))
    (vehicle,) = report.vehicles
    assert (vehicle.sysid, vehicle.compid, vehicle.autopilot, vehicle.vehicle_type) == (3, 1, 12, 2)
    assert (vehicle.imu, vehicle.imu_id, vehicle.imu_count) == ("HIGHRES_IMU", 0, 500)
    assert vehicle.imu_rate == pytest.approx(250.0)
    assert vehicle.t_us == (1_000_000, 2_996_000)
    assert (vehicle.gaps, vehicle.reboots, vehicle.jumps) == ((), 0, 0)
    assert (vehicle.sources.gnss, vehicle.sources.heading) == ("gps_raw_int", "attitude")
    assert vehicle.truth is None
    rates = {m.name: (m.count, m.rate) for m in report.messages}
    assert rates["HIGHRES_IMU"] == (500, pytest.approx(250.0))
    assert rates["HEARTBEAT"] == (1, 0.0)


def test_sources_go_by_the_autopilot() -> None:
    raw = inspect(log(*flight(autopilot=0))).vehicles[0].sources
    assert (raw.gnss, raw.gnss_delay, raw.vertical_velocity) == ("global_position_int", 0.0, True)
    ardupilot = inspect(log(*flight(autopilot=3))).vehicles[0].sources
    assert (ardupilot.gnss, ardupilot.gnss_delay) == ("gps_raw_int", 0.14)
    without_heartbeat = inspect(log(*flight()[1:])).vehicles[0]
    assert without_heartbeat.autopilot is None
    assert without_heartbeat.sources == raw


def test_gaps_reboots_and_bad_samples() -> None:
    records = [(k * 4000, 3, imu(10_000_000 + k * 4000)) for k in range(100)]
    records += [(700_000 + k * 4000, 3, imu(10_600_000 + k * 4000)) for k in range(100)]
    records += [(2_000_000 + k * 4000, 3, imu(500_000 + k * 4000)) for k in range(100)]
    records += [(3_000_000, 3, imu(0))]
    bad = ImuSample(900_000, np.array([math.nan, 0, 0]), np.zeros(3))
    nan = fields_of("HIGHRES_IMU")
    body = bytearray(highres_imu(bad).body)
    body[8:12] = np.float32(math.nan).tobytes()
    records += [(3_004_000, 3, Payload(nan.msgid, nan.crc_extra, bytes(body)))]
    (vehicle,) = inspect(log(*records)).vehicles
    (gap,) = (gap for gap in vehicle.gaps if gap.length > 0.0)
    assert gap.t_us == 10_396_000
    assert gap.length == pytest.approx(0.204)
    assert (vehicle.reboots, vehicle.jumps) == (1, 0)
    assert vehicle.wild_stamps == 3  # two before the reboot was believed, one zero
    assert vehicle.unusable == 1


def test_truth_and_gnss() -> None:
    truth = TruthSample(1_500_000, 0.8, 0.1, 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    fixes = [GnssFix(T0, 0.8, 0.1, 1.0, None, fix) for fix in (1, 3, 6)]
    records = [(600_000, 3, hil_state_quaternion(truth, (0, 0, 0), (0, 0, 0)))]
    records += [(700_000, 3, gps_raw_int(fix)) for fix in fixes]
    (vehicle,) = inspect(log(*flight(), *records)).vehicles
    assert (vehicle.truth, vehicle.truth_count) == ("HIL_STATE_QUATERNION", 1)
    assert (vehicle.gnss_fixes, vehicle.gnss_is_utc) == (2, True)


def test_the_better_imu_of_the_first_second_is_chosen() -> None:
    raw = [
        (t, 3, payload(fields_of("RAW_IMU"), time_usec=1_000_000 + t, id=1))
        for t in range(0, 2_000_000, 20_000)
    ]
    (vehicle,) = inspect(log(*raw)).vehicles
    assert (vehicle.imu, vehicle.imu_id) == ("RAW_IMU", 1)
    (vehicle,) = inspect(log(*sorted([*raw, *flight()[1:]], key=lambda record: record[0]))).vehicles
    assert vehicle.imu == "HIGHRES_IMU"


def test_choosing_a_system() -> None:
    frames = log((0, 255, heartbeat(6, 8)), *flight(7), *flight(2))
    assert imu_systems(frames) == [7, 2]
    assert choose_system(frames) == 7
    assert choose_system(frames, 255) == 255
    with pytest.raises(LogFormatError, match=r"no system 9; it has 2, 7, 255"):
        choose_system(frames, 9)
    silent = log((0, 255, heartbeat(6, 8)))
    with pytest.raises(LogFormatError, match="sends an IMU"):
        choose_system(silent)
    assert inspect(silent).vehicles == ()


@pytest.mark.slow
def test_recordings(shared: Callable[[str], Path]) -> None:
    px4 = inspect(read_tlog(shared("recordings/px4_quad_mission.tlog.xz")))
    (vehicle,) = px4.vehicles
    assert (vehicle.sysid, vehicle.autopilot, vehicle.imu) == (8, 12, "HIGHRES_IMU")
    assert vehicle.truth == "HIL_STATE_QUATERNION"
    ap = inspect(read_tlog(shared("recordings/ap_copter_square_circle.tlog.xz")))
    (vehicle,) = ap.vehicles
    assert (vehicle.sysid, vehicle.autopilot, vehicle.imu) == (1, 3, "HIGHRES_IMU")
    assert vehicle.imu_rate == pytest.approx(250.0, rel=0.01)
    assert vehicle.truth == "SIM_STATE"
    assert {m.sysid for m in ap.messages} == {1, 255}
