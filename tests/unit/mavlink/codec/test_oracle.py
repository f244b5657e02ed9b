"""Every message of ours against pymavlink, both ways and in every dress a packet may wear."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import Payload, fields_of, frame, name_of, payload_rows, scan
from mavins.mavlink.codec.fields import WIRE

MESSAGES = [
    "HIGHRES_IMU",
    "SCALED_IMU",
    "SCALED_IMU2",
    "SCALED_IMU3",
    "RAW_IMU",
    "GPS_RAW_INT",
    "GPS2_RAW",
    "GLOBAL_POSITION_INT",
    "GPS_INPUT",
    "HIL_GPS",
    "ATTITUDE",
    "SYSTEM_TIME",
    "HEARTBEAT",
    "SET_GPS_GLOBAL_ORIGIN",
    "HIL_STATE_QUATERNION",
    "SIM_STATE",
    "LOCAL_POSITION_NED",
    "ATTITUDE_QUATERNION",
    "ODOMETRY",
    "ESTIMATOR_STATUS",
    "SYS_STATUS",
    "GPS_GLOBAL_ORIGIN",
    "HOME_POSITION",
    "STATUSTEXT",
    "COMMAND_ACK",
    "PARAM_VALUE",
    "AUTOPILOT_VERSION",
    "LOCAL_POSITION_NED_COV",
    "ATTITUDE_QUATERNION_COV",
    "GLOBAL_POSITION_INT_COV",
    "VIBRATION",
    "EKF_STATUS_REPORT",
    "EXTENDED_SYS_STATE",
    "VISION_POSITION_ESTIMATE",
]


def one_value(code: str, count: int) -> st.SearchStrategy[Any]:
    if code == "s":
        return st.binary(max_size=count)
    if code in "fd":
        value: st.SearchStrategy[Any] = st.floats(width=32)
    else:
        bits = 8 * struct.calcsize(code)
        low = 0 if code.isupper() else -(2 ** (bits - 1))
        value = st.integers(low, low + 2**bits - 1) | st.just(0)
    return st.lists(value, min_size=count, max_size=count) if count else value


def field_values(name: str) -> st.SearchStrategy[dict[str, Any]]:
    fields = fields_of(name)
    codes = zip(fields.names, fields.codes, fields.counts, strict=True)
    return st.fixed_dictionaries({field: one_value(code, n) for field, code, n in codes})


any_message = st.sampled_from(MESSAGES).flatmap(
    lambda name: st.tuples(st.just(name), field_values(name))
)
headers = st.tuples(st.integers(1, 255), st.integers(1, 255), st.integers(0, 255))


def oracle_message(name: str, values: dict[str, Any]) -> Any:
    return getattr(dialect, f"MAVLink_{name.lower()}_message")(**values)


def oracle_packet(name: str, values: dict[str, Any], dress: str, header: Any = (1, 1, 0)) -> bytes:
    mav = dialect.MAVLink(None, header[0], header[1])
    mav.seq = header[2]
    if dress == "signed":
        mav.signing.secret_key = bytes(32)
        mav.signing.link_id = 3
        mav.signing.timestamp = 12345
        mav.signing.sign_outgoing = True
    packed: bytes = oracle_message(name, values).pack(mav, force_mavlink1=dress == "v1")
    return packed


def same(ours: Any, theirs: Any, code: str) -> bool:
    if code == "s":
        return bytes(ours) == bytes(theirs).rstrip(b"\0")
    ours, theirs = np.atleast_1d(ours), np.atleast_1d(np.array(theirs, ours.dtype))
    return ours.tobytes() == theirs.tobytes() or np.array_equal(ours, theirs, equal_nan=True)


@given(any_message, st.sampled_from(["v1", "v2", "signed"]), headers)
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_what_pymavlink_sends_we_read(
    message: tuple[str, dict[str, Any]], dress: str, header: tuple[int, int, int]
) -> None:
    name, values = message
    fields = fields_of(name)
    if dress == "v1" and fields.msgid > 255:
        dress = "v2"
    packet = oracle_packet(name, values, dress, header)
    frames = scan(packet)
    assert len(frames) == 1
    assert not frames.damage
    assert (frames.sysid[0], frames.compid[0], frames.seq[0]) == header
    assert name_of(int(frames.msgid[0])) == name
    assert frames.packet(0) == packet
    row = payload_rows(frames, np.array([0]), fields)[0]
    for field, code in zip(fields.names, fields.codes, strict=True):
        if code == "s":
            assert bytes(row[field]) == values[field].ljust(1, b"\0").rstrip(b"\0")
        else:
            assert same(row[field], values[field], code), field


@given(any_message, headers)
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_what_we_send_pymavlink_reads(
    message: tuple[str, dict[str, Any]], header: tuple[int, int, int]
) -> None:
    name, values = message
    fields = fields_of(name)
    body = fields.pack(**values)
    packet = frame(Payload(fields.msgid, fields.crc_extra, body), *header)
    parser = dialect.MAVLink(None)
    (read,) = parser.parse_buffer(packet)
    assert read.get_type() == name
    assert (read.get_srcSystem(), read.get_srcComponent(), read.get_seq()) == header
    # a value in range arrives as it was; our NaN policy aside, so do the bytes of the oracle
    finite = all(
        np.isfinite(np.atleast_1d(np.array(values[f], float))).all()
        for f, code in zip(fields.names, fields.codes, strict=True)
        if code in "fd"
    )
    if finite:
        assert packet == oracle_packet(name, values, "v2", header)
    for field, code in zip(fields.names, fields.codes, strict=True):
        if code in "fd":
            sent = np.atleast_1d(np.array(values[field], float))
            got = np.atleast_1d(np.array(getattr(read, field), float))
            assert np.isfinite(got[np.isfinite(sent)]).all()
            assert not np.isinf(got).any()


@pytest.mark.parametrize("name", MESSAGES)
def test_out_of_range_is_clamped_and_nothing_raises(name: str) -> None:
    fields = fields_of(name)
    for extreme in (math.inf, -math.inf, math.nan, 1e300, -1e300, 2.0**64, -(2.0**63)):
        values = {
            field: [extreme] * n if n else extreme
            for field, code, n in zip(fields.names, fields.codes, fields.counts, strict=True)
            if code != "s"
        }
        assert len(fields.pack(**values)) == fields.unpacker.size


def test_a_field_that_does_not_exist_is_our_mistake() -> None:
    with pytest.raises(KeyError, match="no field nonsense"):
        fields_of("HEARTBEAT").pack(nonsense=1)
    with pytest.raises(KeyError, match="NO_SUCH"):
        fields_of("NO_SUCH")


@pytest.mark.parametrize(
    ("name", "base", "full"),
    [
        ("HIGHRES_IMU", 62, 63),
        ("GPS_RAW_INT", 30, 52),
        ("GPS2_RAW", 35, 57),
        ("SCALED_IMU", 22, 24),
        ("RAW_IMU", 26, 29),
        ("HIL_GPS", 36, 39),
        ("GPS_INPUT", 63, 65),
        ("SIM_STATE", 84, 92),
        ("SET_GPS_GLOBAL_ORIGIN", 13, 21),
        ("HEARTBEAT", 9, 9),
        ("ODOMETRY", 230, 233),
        ("STATUSTEXT", 51, 54),
    ],
)
def test_extensions_are_told_from_the_original_message(name: str, base: int, full: int) -> None:
    fields = fields_of(name)
    assert (fields.min_length, fields.unpacker.size) == (base, full)
    assert WIRE[fields.msgid] == fields.crc_extra | base << 8 | full << 16


@pytest.mark.parametrize("name", ["HIGHRES_IMU", "GPS_RAW_INT", "SCALED_IMU", "RAW_IMU", "HIL_GPS"])
def test_a_v1_packet_without_extensions_is_read_with_zeros_in_them(name: str) -> None:
    fields = fields_of(name)
    body = bytes(range(1, fields.min_length + 1))
    head = bytes([0xFE, len(body), 7, 3, 4, fields.msgid])
    crc = dialect.x25crc(head[1:] + body)
    crc.accumulate(bytes([fields.crc_extra]))
    frames = scan(head + body + crc.crc.to_bytes(2, "little"))
    assert len(frames) == 1
    assert frames.body(0, fields.unpacker.size) == body.ljust(fields.unpacker.size, b"\0")
