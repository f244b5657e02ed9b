"""Payloads -> SI: units, unknown values, what is refused, and one against many."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import (
    IMU_KINDS,
    Attitude,
    Frames,
    GlobalPosition,
    GpsInput,
    GpsRaw,
    Heartbeat,
    HilGps,
    HilState,
    ImuMessage,
    Invalid,
    LocalPosition,
    OriginRequest,
    SimState,
    SystemTime,
    decode,
    decode_imu,
    decode_truth,
    decode_yaws,
    fields_of,
    scan,
)

U16, U32 = 0xFFFF, 0xFFFFFFFF


def received(name: str, **values: Any) -> Frames:
    """The frame of a message as pymavlink sends it; what is not named is zero."""
    fields = fields_of(name)
    full = {
        field: values.get(field, b"" if code == "s" else [0] * n if n else 0)
        for field, code, n in zip(fields.names, fields.codes, fields.counts, strict=True)
    }
    message = getattr(dialect, f"MAVLink_{name.lower()}_message")(**full)
    return scan(message.pack(dialect.MAVLink(None, 1, 1)))


def message(name: str, **values: Any) -> Any:
    return decode(received(name, **values), 0)


GPS = {"lat": 473977432, "lon": 85455944, "alt": 489400, "fix_type": 3, "satellites_visible": 12}


class TestImu:
    def test_highres_imu(self) -> None:
        imu = message(
            "HIGHRES_IMU",
            time_usec=5_000_004,
            xacc=0.5,
            yacc=-0.25,
            zacc=-9.75,
            xgyro=0.125,
            zgyro=-1.5,
            fields_updated=0x1FFF,
            id=2,
        )
        assert isinstance(imu, ImuMessage)
        assert (imu.kind, imu.imu_id, imu.stamp_us, imu.wraps) == (
            "HIGHRES_IMU",
            2,
            5_000_004,
            False,
        )
        assert imu.accel_b.tolist() == [0.5, -0.25, -9.75]
        assert imu.gyro_b.tolist() == [0.125, 0.0, -1.5]

    @pytest.mark.parametrize("fields_updated", [0, 0x07, 0x38, 0x1FC0, 0x3E])
    def test_stale_accelerometer_or_gyro_is_refused(self, fields_updated: int) -> None:
        assert message("HIGHRES_IMU", time_usec=1, fields_updated=fields_updated) == Invalid(
            "HIGHRES_IMU", "no new accelerometer and gyro"
        )

    @pytest.mark.parametrize("name", ["SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"])
    def test_scaled_imu(self, name: str) -> None:
        imu = message(name, time_boot_ms=U32, zacc=-1000, xgyro=500)
        assert imu.accel_b == pytest.approx([0, 0, -9.80665])
        assert imu.gyro_b == pytest.approx([0.5, 0, 0])
        assert imu.stamp_us == U32 * 1000
        assert imu.kind == name
        assert imu.wraps

    def test_raw_imu(self) -> None:
        imu = message("RAW_IMU", time_usec=77, xacc=100, ygyro=-250, id=1)
        assert imu.accel_b == pytest.approx([0.980665, 0, 0])
        assert imu.gyro_b == pytest.approx([0, -0.25, 0])
        assert (imu.stamp_us, imu.imu_id, imu.wraps) == (77, 1, False)

    @pytest.mark.parametrize("field", ["xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro"])
    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 3000.0, -1e30])
    def test_no_bad_number_gets_through(self, field: str, bad: float) -> None:
        frames = received("HIGHRES_IMU", time_usec=1, fields_updated=0x3F, **{field: bad})
        assert isinstance(decode(frames, 0), Invalid)
        rows = decode_imu(frames, np.array([0]))
        assert not rows.valid[0]

    def test_a_stamp_beyond_reason_is_refused(self) -> None:
        frames = received("HIGHRES_IMU", time_usec=2**64 - 1, fields_updated=0x3F)
        assert decode(frames, 0) == Invalid("HIGHRES_IMU", "stamp out of range")
        assert not decode_imu(frames, np.array([0])).valid[0]


angles = st.floats(width=32) | st.floats(-8.0, 8.0, width=32)


@given(st.lists(st.tuples(*[angles] * 6), min_size=1, max_size=5))
def test_many_yaws_are_those_of_one_by_one(rows: list[tuple[float, ...]]) -> None:
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    packets = [
        received("ATTITUDE", time_boot_ms=1, **dict(zip(names, row, strict=True))).packet(0)
        for row in rows
    ]
    frames = scan(b"".join(packets))
    for i, yaw in enumerate(decode_yaws(frames, np.arange(len(rows)))):
        one = decode(frames, i)
        assert yaw == one.yaw if isinstance(one, Attitude) else math.isnan(yaw)


imu_values = st.fixed_dictionaries(
    {f"{axis}{sensor}": st.integers(-32768, 32767) for axis in "xyz" for sensor in ("acc", "gyro")}
)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(IMU_KINDS.values())),
            imu_values,
            st.sampled_from([0x3F, 0x3F, 7]),
        ),
        min_size=1,
        max_size=12,
    )
)
@settings(deadline=None)
def test_many_rows_are_bit_for_bit_the_single_ones(
    rows: list[tuple[str, dict[str, int], int]],
) -> None:
    packets = []
    for k, (name, values, updated) in enumerate(rows):
        scaled = {field: value / 100.0 for field, value in values.items()}
        if name == "HIGHRES_IMU":
            frames = received(name, time_usec=k, fields_updated=updated, id=k % 3, **scaled)
        elif name == "RAW_IMU":
            frames = received(name, time_usec=k, id=k % 3, **values)
        else:
            frames = received(name, time_boot_ms=k, **values)
        packets.append(frames.packet(0))
    frames = scan(b"".join(packets))
    many = decode_imu(frames, np.arange(len(rows)))
    assert len(many) == len(rows)
    for i in range(len(rows)):
        one = decode(frames, i)
        assert many.valid[i] == isinstance(one, ImuMessage)
        if isinstance(one, ImuMessage):
            assert many.accel_b[i].tobytes() == one.accel_b.tobytes()
            assert many.gyro_b[i].tobytes() == one.gyro_b.tobytes()
            assert (many.stamp_us[i], many.imu_id[i]) == (one.stamp_us, one.imu_id)
            assert IMU_KINDS[int(many.msgid[i])] == one.kind


class TestGnss:
    @pytest.mark.parametrize("name", ["GPS_RAW_INT", "GPS2_RAW"])
    def test_a_receiver(self, name: str) -> None:
        fix = message(
            name,
            **GPS,
            time_usec=9,
            vel=525,
            cog=18000,
            eph=121,
            epv=200,
            h_acc=900,
            v_acc=1780,
            vel_acc=400,
            hdg_acc=200_000,
            yaw=9000,
        )
        assert isinstance(fix, GpsRaw)
        assert fix.kind == name
        assert math.degrees(fix.lat) == pytest.approx(47.3977432, abs=1e-12)
        assert math.degrees(fix.lon) == pytest.approx(8.5455944, abs=1e-12)
        assert fix.alt == pytest.approx(489.4)
        assert (fix.stamp_us, fix.fix_type, fix.satellites) == (9, 3, 12)
        assert fix.speed == pytest.approx(5.25)
        assert fix.course == pytest.approx(math.pi)
        assert (fix.eph, fix.epv) == pytest.approx((1.21, 2.0))
        assert (fix.h_acc, fix.v_acc, fix.vel_acc) == pytest.approx((0.9, 1.78, 0.4))
        assert fix.hdg_acc == pytest.approx(math.radians(2.0))
        assert fix.yaw == pytest.approx(math.pi / 2)

    @pytest.mark.parametrize("name", ["GPS_RAW_INT", "GPS2_RAW"])
    def test_what_the_receiver_does_not_know_is_none(self, name: str) -> None:
        for unknown in (0, U32):
            fix = message(
                name,
                **(GPS | {"satellites_visible": 255}),
                vel=U16,
                cog=U16,
                eph=U16,
                epv=U16,
                h_acc=unknown,
                v_acc=unknown,
                vel_acc=unknown,
                hdg_acc=unknown,
                yaw=U16 if unknown else 0,
            )
            for field in ("speed", "course", "satellites", "eph", "epv"):
                assert getattr(fix, field) is None
            for field in ("h_acc", "v_acc", "vel_acc", "hdg_acc", "yaw"):
                assert getattr(fix, field) is None

    def test_yaw_north_is_36000(self) -> None:
        assert message("GPS_RAW_INT", **GPS, yaw=36000).yaw == 0.0
        assert message("HIL_GPS", **GPS, yaw=36000).yaw == 0.0
        assert message("GPS_INPUT", lat=1, lon=1, fix_type=3, yaw=36000).yaw == 0.0

    @pytest.mark.parametrize("name", ["GPS_RAW_INT", "GPS2_RAW", "HIL_GPS"])
    @pytest.mark.parametrize(
        ("change", "reason"),
        [
            ({"lat": 900_000_001}, "position out of range"),
            ({"lon": -1_800_000_001}, "position out of range"),
            ({"alt": 2_000_000_000}, "altitude out of range"),
            ({"lat": 0, "lon": 0}, "position 0/0"),
            ({"time_usec": 2**63}, "stamp out of range"),
        ],
    )
    def test_impossible_fixes_are_refused(
        self, name: str, change: dict[str, int], reason: str
    ) -> None:
        assert message(name, **(GPS | change)) == Invalid(name, reason)

    def test_without_a_fix_zero_is_just_no_position(self) -> None:
        fix = message("GPS_RAW_INT", fix_type=1, satellites_visible=3)
        assert (fix.fix_type, fix.satellites) == (1, 3)

    def test_global_position_int(self) -> None:
        position = message(
            "GLOBAL_POSITION_INT",
            time_boot_ms=5,
            lat=-353632620,
            lon=1491652370,
            alt=584000,
            relative_alt=-250,
            vx=-120,
            vy=340,
            vz=5,
            hdg=27000,
        )
        assert isinstance(position, GlobalPosition)
        assert (math.degrees(position.lat), math.degrees(position.lon)) == pytest.approx(
            (-35.363262, 149.165237), abs=1e-12
        )
        assert (position.alt, position.relative_alt) == pytest.approx((584.0, -0.25))
        assert position.v_l == pytest.approx((-1.2, 3.4, 0.05))
        assert position.heading == pytest.approx(1.5 * math.pi)
        assert position.stamp_us == 5000
        unknown = message("GLOBAL_POSITION_INT", lat=1, lon=1, hdg=U16)
        assert unknown.heading is None
        assert message("GLOBAL_POSITION_INT") == Invalid("GLOBAL_POSITION_INT", "position 0/0")

    def test_local_position_ned(self) -> None:
        values = {"x": 1.5, "y": -2.5, "z": -30.0, "vx": 3.0, "vy": 4.0, "vz": 0.5}
        assert message("LOCAL_POSITION_NED", time_boot_ms=7, **values) == LocalPosition(
            7000, (1.5, -2.5, -30.0), (3.0, 4.0, 0.5)
        )
        for bad, reason in (
            ({"y": math.nan}, "not a finite number"),
            ({"vz": math.inf}, "not a finite number"),
            ({"vx": 2000.0}, "velocity out of range"),
        ):
            found = message("LOCAL_POSITION_NED", **{**values, **bad})
            assert found == Invalid("LOCAL_POSITION_NED", reason)

    def test_gps_input(self) -> None:
        fix = message(
            "GPS_INPUT",
            time_usec=4,
            gps_id=1,
            lat=473977432,
            lon=85455944,
            alt=12.5,
            fix_type=6,
            satellites_visible=20,
            vn=1.0,
            ve=2.0,
            vd=-0.5,
            speed_accuracy=0.25,
            horiz_accuracy=0.5,
            vert_accuracy=0.75,
            hdop=1.5,
            yaw=18000,
        )
        assert isinstance(fix, GpsInput)
        assert fix.v_l == (1.0, 2.0, -0.5)
        assert (fix.alt, fix.h_acc, fix.v_acc, fix.vel_acc) == (12.5, 0.5, 0.75, 0.25)
        assert (fix.hdop, fix.vdop, fix.gps_id) == (1.5, None, 1)
        assert fix.yaw == pytest.approx(math.pi)

    def test_gps_input_ignores_what_its_flags_say_even_if_it_is_nan(self) -> None:
        values = dict.fromkeys(("alt", "hdop", "vdop", "vn", "ve", "vd"), math.nan)
        values |= dict.fromkeys(("speed_accuracy", "horiz_accuracy", "vert_accuracy"), math.nan)
        fix = message("GPS_INPUT", lat=1, lon=1, fix_type=3, ignore_flags=255, **values)
        assert isinstance(fix, GpsInput)
        assert fix.v_l is None
        assert (fix.alt, fix.h_acc, fix.v_acc, fix.vel_acc, fix.hdop) == (None,) * 5
        horizontal = message(
            "GPS_INPUT", lat=1, lon=1, fix_type=3, ignore_flags=16, vn=1, vd=math.nan
        )
        assert horizontal.v_l[:2] == (1.0, 0.0)
        assert math.isnan(horizontal.v_l[2])
        for field in ("vn", "vd", "alt"):
            bad = message("GPS_INPUT", lat=1, lon=1, fix_type=3, **{field: math.nan})
            assert isinstance(bad, Invalid)

    def test_hil_gps(self) -> None:
        fix = message("HIL_GPS", **GPS, time_usec=8, eph=100, epv=U16, vn=150, ve=-20, vd=3, id=1)
        assert isinstance(fix, HilGps)
        assert fix.v_l == pytest.approx((1.5, -0.2, 0.03))
        assert (fix.eph, fix.epv, fix.gps_id, fix.yaw) == (1.0, None, 1, None)


class TestOthers:
    def test_attitude(self) -> None:
        attitude = message("ATTITUDE", time_boot_ms=3, roll=0.25, pitch=-0.5, yaw=3.0, yawspeed=1.0)
        assert attitude == Attitude(3000, 0.25, -0.5, 3.0, (0.0, 0.0, 1.0))

    @pytest.mark.parametrize("field", ["roll", "pitch", "yaw", "rollspeed"])
    def test_attitude_with_a_bad_number_is_refused(self, field: str) -> None:
        assert isinstance(message("ATTITUDE", **{field: math.nan}), Invalid)

    def test_system_time(self) -> None:
        unix = 1_750_000_000_000_000
        assert message("SYSTEM_TIME", time_unix_usec=unix, time_boot_ms=7) == SystemTime(unix, 7000)
        for unknown in (0, 12345, 2**63):
            assert message("SYSTEM_TIME", time_unix_usec=unknown).unix_us is None

    def test_heartbeat(self) -> None:
        heartbeat = message(
            "HEARTBEAT", type=2, autopilot=12, base_mode=81, system_status=4, custom_mode=65536
        )
        assert heartbeat == Heartbeat(2, 12, 81, 4, 65536)

    def test_origin(self) -> None:
        origin = message(
            "SET_GPS_GLOBAL_ORIGIN",
            target_system=9,
            latitude=10_000_000,
            longitude=-20_000_000,
            altitude=1500,
        )
        assert isinstance(origin, OriginRequest)
        assert (origin.target_system, origin.alt) == (9, 1.5)
        assert (math.degrees(origin.lat), math.degrees(origin.lon)) == pytest.approx((1.0, -2.0))

    def test_messages_of_others_are_not_ours(self) -> None:
        assert message("STATUSTEXT", severity=3) is None


class TestTruth:
    def test_it_is_not_a_sensor_message(self) -> None:
        for name in ("HIL_STATE_QUATERNION", "SIM_STATE"):
            assert message(name) is None
        assert decode_truth(received("HEARTBEAT"), 0) is None

    def test_hil_state_quaternion(self) -> None:
        frames = received(
            "HIL_STATE_QUATERNION",
            time_usec=6,
            attitude_quaternion=[0.5, 0.5, -0.5, 0.5],
            yawspeed=0.25,
            lat=473977432,
            lon=85455944,
            alt=500_000,
            vx=100,
            vy=-200,
            vz=50,
        )
        truth = decode_truth(frames, 0)
        assert isinstance(truth, HilState)
        assert (truth.stamp_us, truth.alt, truth.q_lb) == (6, 500.0, (0.5, 0.5, -0.5, 0.5))
        assert truth.v_l == pytest.approx((1.0, -2.0, 0.5))
        assert truth.rates == (0.0, 0.0, 0.25)

    def test_sim_state_uses_the_integer_position(self) -> None:
        position = {"lat_int": -353632620, "lon_int": 1491652370, "lat": 3.0, "lon": 4.0}
        truth = decode_truth(received("SIM_STATE", q1=1.0, alt=584.0, vn=2.0, **position), 0)
        assert isinstance(truth, SimState)
        assert math.degrees(truth.lat) == pytest.approx(-35.363262, abs=1e-12)
        assert (truth.alt, truth.v_l, truth.q_lb) == (584.0, (2.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))

    def test_a_quaternion_that_is_none_is_refused(self) -> None:
        assert isinstance(decode_truth(received("SIM_STATE", lat_int=1, lon_int=1), 0), Invalid)


@given(
    st.sampled_from(
        ["HIGHRES_IMU", "GPS_INPUT", "ATTITUDE", "GPS_RAW_INT", "GPS2_RAW", "SIM_STATE"]
    ),
    st.data(),
)
@settings(deadline=None)
def test_any_payload_whatever_gives_an_answer(name: str, data: st.DataObject) -> None:
    fields = fields_of(name)
    body = data.draw(st.binary(min_size=1, max_size=fields.unpacker.size))
    head = bytes([0xFD, len(body), 0, 0, 0, 1, 1]) + fields.msgid.to_bytes(3, "little")
    crc = dialect.x25crc(head[1:] + body)
    crc.accumulate(bytes([fields.crc_extra]))
    frames = scan(head + body + crc.crc.to_bytes(2, "little"))
    assert len(frames) == 1
    answer = decode(frames, 0) or decode_truth(frames, 0)
    assert answer is not None
    if isinstance(answer, ImuMessage):
        assert np.isfinite(answer.accel_b).all()
        assert decode_imu(frames, np.array([0])).valid[0]
