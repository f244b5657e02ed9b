"""SI -> payloads, read back by pymavlink: units, unknown values, limits, and what our decoders make
of it.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink import codec
from mavins.mavlink.codec import Payload, decode, decode_truth, frame, scan
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import euler_to_quat, quat_exp, quat_mul, quat_to_dcm, quat_to_euler
from mavins.types import GnssFix, Health, ImuSample, NavSolution, Origin, TruthSample


def as_pymavlink(payload: Payload) -> Any:
    (message,) = dialect.MAVLink(None).parse_buffer(frame(payload, 100, 1, 7))
    return message


def decoded(payload: Payload) -> Any:
    return decode(scan(frame(payload, 1, 1, 0)), 0)


def solution(**changes: Any) -> NavSolution:
    origin = Origin(math.radians(47.0), math.radians(8.0), 400.0)
    p_n = np.array([100.0, -50.0, -20.0])
    lat, lon, alt = TangentFrame.at(origin).to_lla(p_n)
    q = euler_to_quat(0.1, -0.2, 2.5)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(15, 15)) * 0.1
    values = {
        "t_us": 123_456_789,
        "lat": lat,
        "lon": lon,
        "alt": alt,
        "p_n": p_n,
        "v_n": np.array([3.0, -1.0, 0.5]),
        "q_nb": q,
        "v_l": np.array([3.0, -1.0, 0.5]),
        "q_lb": q,
        "roll": 0.1,
        "pitch": -0.2,
        "yaw": 2.5,
        "w_b": np.array([0.01, -0.02, 0.3]),
        "f_b": np.array([0.5, 0.25, -9.75]),
        "b_g": np.zeros(3),
        "b_a": np.zeros(3),
        "P": root @ root.T,
        "sd_euler": np.array([0.01, 0.01, 0.02]),
        "l_b": np.zeros(3),
        "sd_l_b": np.zeros(3),
        "tau": 0.0,
        "sd_tau": 0.0,
        "b_baro": 0.0,
        "sd_b_baro": 0.0,
        "b_m": np.zeros(3),
        "sd_b_m": np.zeros(3),
        "g_n": np.zeros(2),
        "sd_g_n": np.zeros(2),
        "health": Health.RUNNING,
        "reset_counter": 258,
    }
    return NavSolution(**(values | changes))


class TestSensors:
    def test_highres_imu_returns_as_it_was_to_a_float32(self) -> None:
        sample = ImuSample(5_000_004, np.array([0.1, -0.2, -9.8]), np.array([0.01, 0.02, -0.03]))
        imu = decoded(codec.highres_imu(sample, imu_id=1))
        assert (imu.stamp_us, imu.imu_id) == (5_000_004, 1)
        assert imu.accel_b.tolist() == sample.accel_b.astype(np.float32).tolist()
        assert imu.gyro_b.tolist() == sample.gyro_b.astype(np.float32).tolist()
        assert as_pymavlink(codec.highres_imu(sample)).fields_updated == 0x3F

    @given(
        st.floats(-math.pi / 2, math.pi / 2),
        st.floats(-math.pi, math.pi),
        st.floats(-400, 9000),
        st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-5, 5)),
    )
    @settings(deadline=None)
    def test_gps_raw_int_returns_to_its_resolution(
        self, lat: float, lon: float, alt: float, v_l: tuple[float, float, float]
    ) -> None:
        fix = GnssFix(7, lat, lon, alt, v_l, 3, 12, sigma_h=0.9, sigma_v=1.78, sigma_speed=0.4)
        back = decoded(codec.gps_raw_int(fix, eph=1.21, yaw=-0.5))
        if isinstance(back, codec.Invalid):
            assert back.reason == "position 0/0"
            return
        assert (back.lat, back.lon) == pytest.approx((lat, lon), abs=1e-9)
        assert back.alt == pytest.approx(alt, abs=6e-4)
        assert back.speed == pytest.approx(math.hypot(v_l[0], v_l[1]), abs=6e-3)
        if back.speed > 1.0:
            error = back.course - math.atan2(v_l[1], v_l[0])
            assert abs(math.remainder(error, 2 * math.pi)) < 1e-4
        assert (back.h_acc, back.v_acc, back.vel_acc) == pytest.approx((0.9, 1.78, 0.4))
        assert (back.eph, back.epv, back.satellites) == (pytest.approx(1.21), None, 12)
        assert back.yaw == pytest.approx(2 * math.pi - 0.5, abs=1e-4)

    @pytest.mark.parametrize("v_l", [None, (math.nan, 1.0, 0.0)])
    def test_gps_raw_int_of_a_receiver_that_knows_little(self, v_l: Any) -> None:
        message = as_pymavlink(codec.gps_raw_int(GnssFix(7, 0.5, 0.5, 1.0, v_l, 2)))
        assert (message.vel, message.cog, message.satellites_visible) == (65535, 65535, 255)
        assert (message.eph, message.epv) == (65535, 65535)
        assert (message.h_acc, message.v_acc, message.vel_acc, message.yaw) == (0, 0, 0, 0)

    def test_yaw_and_accuracies_never_read_as_unknown_by_rounding(self) -> None:
        fix = GnssFix(7, 0.5, 0.5, 1.0, (1.0, -1e-9, 0.0), 6, sigma_h=1e-5)
        message = as_pymavlink(codec.gps_raw_int(fix, yaw=0.0))
        assert (message.h_acc, message.yaw, message.cog) == (1, 36000, 0)

    def test_global_position_int(self) -> None:
        payload = codec.global_position_int(
            2**32 * 1000 + 5999, 0.5, -0.25, 12.3456, -1.5, (1, -2, 0.5), -0.5
        )
        message = as_pymavlink(payload)
        assert message.time_boot_ms == 5
        assert (message.alt, message.relative_alt) == (12346, -1500)
        assert (message.vx, message.vy, message.vz) == (100, -200, 50)
        assert message.hdg == round(math.degrees(2 * math.pi - 0.5) * 100)
        assert decoded(payload).lat == pytest.approx(0.5, abs=1e-9)
        nowhere = codec.global_position_int(0, 0.5, 0.5, 0, 0, (0, 0, 0), None)
        assert as_pymavlink(nowhere).hdg == 65535

    def test_attitude_system_time_heartbeat(self) -> None:
        attitude = decoded(codec.attitude(7_000_999, 0.5, -0.25, 3.0, (1.0, 2.0, 3.0)))
        assert attitude == codec.Attitude(7_000_000, 0.5, -0.25, 3.0, (1.0, 2.0, 3.0))
        unix = 1_750_000_000_000_000
        assert decoded(codec.system_time(unix, 5_000_000)) == codec.SystemTime(unix, 5_000_000)
        beat = codec.heartbeat(2, 12, 81, 3, 65536)
        assert decoded(beat) == codec.Heartbeat(2, 12, 81, 3, 65536)
        assert as_pymavlink(beat).mavlink_version == 3

    def test_hil_state_quaternion(self) -> None:
        truth = TruthSample(9, 0.5, -0.25, 100.0, (1.0, -2.0, 0.5), (0.5, 0.5, -0.5, 0.5))
        payload = codec.hil_state_quaternion(truth, (0.0, 0.0, -9.80665), (0.1, 0.2, 0.3))
        assert as_pymavlink(payload).zacc == -1000
        back = decode_truth(scan(frame(payload, 1, 1, 0)), 0)
        assert isinstance(back, codec.HilState)
        assert (back.stamp_us, back.alt, back.q_lb) == (9, 100.0, truth.q_lb)
        assert back.v_l == pytest.approx(truth.v_l)
        assert (back.lat, back.lon) == pytest.approx((0.5, -0.25), abs=1e-9)


class TestEstimate:
    def test_position_and_attitude(self) -> None:
        s = solution()
        local = as_pymavlink(codec.local_position_ned(s))
        assert (local.x, local.y, local.z) == (100.0, -50.0, -20.0)
        assert (local.vx, local.vy, local.vz, local.time_boot_ms) == (3.0, -1.0, 0.5, 123_456)
        euler = as_pymavlink(codec.attitude_from(s))
        assert (euler.roll, euler.pitch, euler.yaw) == pytest.approx((0.1, -0.2, 2.5))
        quaternion = as_pymavlink(codec.attitude_quaternion(s))
        q = [quaternion.q1, quaternion.q2, quaternion.q3, quaternion.q4]
        assert q == pytest.approx(s.q_lb.tolist())
        assert quaternion.yawspeed == pytest.approx(0.3)
        position = as_pymavlink(codec.global_position_from(s, home_alt=400.0))
        assert position.lat == pytest.approx(math.degrees(s.lat) * 1e7, abs=0.6)
        assert position.relative_alt == pytest.approx(20_000, abs=2)
        assert position.hdg == round(math.degrees(2.5) * 100)
        imu = as_pymavlink(codec.highres_imu_from(s))
        assert (imu.xacc, imu.zacc, imu.fields_updated) == (0.5, -9.75, 0x3F)

    def test_odometry_fields(self) -> None:
        s = solution()
        odometry = as_pymavlink(codec.odometry(s, dialect.MAV_ESTIMATOR_TYPE_VIO, quality=80))
        assert odometry.frame_id == dialect.MAV_FRAME_LOCAL_NED
        assert odometry.child_frame_id == dialect.MAV_FRAME_BODY_FRD
        assert odometry.estimator_type == dialect.MAV_ESTIMATOR_TYPE_VIO
        assert (odometry.reset_counter, odometry.quality) == (2, 80)
        body = quat_to_dcm(s.q_nb).T @ s.v_n
        assert (odometry.vx, odometry.vy, odometry.vz) == pytest.approx(tuple(body))
        _, pose, twist = codec.pose_and_twist(s)
        diagonal = [odometry.pose_covariance[k] for k in (0, 6, 11, 15, 18, 20)]
        assert diagonal == pytest.approx(np.diag(pose).tolist(), rel=1e-6)
        assert odometry.pose_covariance[5] == pytest.approx(pose[0, 5], rel=1e-6)
        assert odometry.velocity_covariance[1] == pytest.approx(twist[0, 1], rel=1e-6)

    def test_covariances_are_those_of_perturbed_solutions(self) -> None:
        s = solution()
        root = np.linalg.cholesky(s.P + 1e-12 * np.eye(15))
        C_bn = quat_to_dcm(s.q_nb).T
        euler, body = quat_to_euler(s.q_nb), C_bn @ s.v_n
        step = 1e-6
        pose, twist = np.zeros((6, 15)), np.zeros((6, 15))
        for k in range(15):
            e = step * root[:, k]
            q = quat_mul(s.q_nb, quat_exp(np.ascontiguousarray(e[6:9])))
            pose[0:3, k] = e[0:3]
            pose[3:6, k] = quat_to_euler(q) - euler
            twist[0:3, k] = quat_to_dcm(q).T @ (s.v_n + e[3:6]) - body
            twist[3:6, k] = -e[9:12]
        pose, twist = pose / step, twist / step
        assert codec.pose_and_twist(s)[1] == pytest.approx(pose @ pose.T, abs=1e-5)
        assert codec.pose_and_twist(s)[2] == pytest.approx(twist @ twist.T, abs=1e-5)

    def test_estimator_status(self) -> None:
        s = solution()
        status = as_pymavlink(codec.estimator_status(s, flags=0x37, vel_ratio=0.25))
        assert (status.flags, status.vel_ratio, status.time_usec) == (0x37, 0.25, 123_456_789)
        assert status.pos_horiz_accuracy == pytest.approx(math.sqrt(s.P[0, 0] + s.P[1, 1]))
        assert status.pos_vert_accuracy == pytest.approx(math.sqrt(s.P[2, 2]))

    def test_nan_never_goes_out(self) -> None:
        nan = np.full(3, math.nan)
        s = dataclasses.replace(
            solution(), p_n=nan, v_n=nan, w_b=nan, P=np.full((15, 15), math.nan), yaw=math.nan
        )
        for payload in (
            codec.local_position_ned(s),
            codec.attitude_from(s),
            codec.attitude_quaternion(s),
            codec.global_position_from(s, 0.0),
        ):
            for value in as_pymavlink(payload).to_dict().values():
                assert not isinstance(value, float) or math.isfinite(value)


class TestSmallTalk:
    def test_sys_status_says_that_there_is_no_battery(self) -> None:
        status = as_pymavlink(
            codec.sys_status(0x2F, 0x2F, 0x0F, load=0.125, drop_rate=0.5, errors=70000)
        )
        assert (status.onboard_control_sensors_health, status.load) == (0x0F, 125)
        assert (status.voltage_battery, status.current_battery, status.battery_remaining) == (
            65535,
            -1,
            -1,
        )
        assert (status.drop_rate_comm, status.errors_comm) == (5000, 65535)

    def test_origin_and_home(self) -> None:
        origin = Origin(math.radians(47.5), math.radians(-8.25), 123.456)
        message = as_pymavlink(codec.gps_global_origin(origin, 5))
        assert (message.latitude, message.longitude, message.altitude) == (
            475000000,
            -82500000,
            123456,
        )
        home = as_pymavlink(codec.home_position(origin, np.array([1.0, 2.0, 3.0]), 5))
        assert (home.latitude, home.x, home.z, home.time_usec) == (475000000, 1.0, 3.0, 5)
        assert all(math.isnan(part) for part in home.q)

    @given(
        st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=400),
        st.integers(0, 200_000),
    )
    @settings(deadline=None)
    def test_statustext_comes_together_again(self, text: str, text_id: int) -> None:
        payloads = codec.statustext(text, dialect.MAV_SEVERITY_WARNING, text_id)
        parts = []
        for k, payload in enumerate(payloads):
            body = payload.body
            assert body[51:53] == payloads[0].body[51:53]
            assert body[53] == k
            parts.append(body[1:51].rstrip(b"\0"))
            parts[-1].decode()  # every chunk is whole characters
        assert b"".join(parts).decode() == text
        text_id_sent = int.from_bytes(payloads[0].body[51:53], "little")
        assert (text_id_sent == 0) == (len(payloads) == 1)
        if len(payloads) > 1:
            assert payloads[-1].body[50] == 0  # the last chunk ends with a zero

    def test_command_ack_param_value_autopilot_version(self) -> None:
        ack = as_pymavlink(codec.command_ack(512, dialect.MAV_RESULT_UNSUPPORTED, 255, 190))
        assert (ack.command, ack.result, ack.target_system, ack.target_component) == (
            512,
            3,
            255,
            190,
        )
        value = as_pymavlink(codec.param_value("GNSS_DELAY", 0.14, 3, 20))
        assert (value.param_id, value.param_index, value.param_count) == ("GNSS_DELAY", 3, 20)
        assert value.param_type == dialect.MAV_PARAM_TYPE_REAL32
        assert value.param_value == pytest.approx(0.14)
        longest = as_pymavlink(codec.param_value("A_NAME_OF_16_CHR", 1.0, 65535, 1))
        assert longest.param_id == "A_NAME_OF_16_CHR"
        version = as_pymavlink(codec.autopilot_version(0x2000, (1, 2, 3), uid=5))
        assert (version.capabilities, version.flight_sw_version, version.uid) == (
            0x2000,
            0x010203FF,
            5,
        )


def test_sequence_and_zero_payload() -> None:
    empty = Payload(0, 50, bytes(9))
    packet = frame(empty, 1, 1, 256 + 7)
    assert packet[4] == 7
    assert packet[1] == 1  # MAVLink 2 never cuts the first byte
    assert len(scan(packet)) == 1


class TestPacking:
    @pytest.mark.parametrize("name", ["ATTITUDE", "ODOMETRY", "GLOBAL_POSITION_INT"])
    def test_usual_values_are_packed_as_any(self, name: str) -> None:
        fields = codec.fields_of(name)
        rng = np.random.default_rng(4)
        values: dict[str, Any] = {
            field: rng.integers(1, 100, max(count, 1)).tolist()
            for field, count in zip(fields.names, fields.counts, strict=True)
        }
        values = {
            f: v if c else v[0] for (f, v), c in zip(values.items(), fields.counts, strict=True)
        }
        usual = fields._pack_usual(values)
        assert usual is not None
        assert usual == fields._pack_any(dict(values))

    @pytest.mark.parametrize("value", [math.nan, math.inf, 1e39])
    def test_what_is_not_usual_is_clamped(self, value: float) -> None:
        fields = codec.fields_of("ATTITUDE")
        assert fields._pack_usual({"roll": value}) is None
        roll = fields.unpacker.unpack(fields.pack(roll=value))[1]
        assert math.isfinite(roll)

    def test_a_field_that_is_not_there(self) -> None:
        with pytest.raises(KeyError):
            codec.fields_of("ATTITUDE").pack(rol=1.0)
