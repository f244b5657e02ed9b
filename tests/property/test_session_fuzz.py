"""Whatever comes in, a session neither raises nor sends a NaN, and its tables stay bounded."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.config import Config, load
from mavins.estimator.estimator import Estimator, Outputs
from mavins.mavlink.codec import (
    attitude,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
)
from mavins.mavlink.session import Session, Surroundings
from mavins.mavlink.vehicle import Vehicle
from mavins.parameters import TABLE, ConfigStore, file_keeper
from mavins.tlog_source import tune
from mavins.types import GnssFix, ImuSample

pytestmark = pytest.mark.jit

HANDLED = (
    "HEARTBEAT",
    "SYSTEM_TIME",
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
    "SET_GPS_GLOBAL_ORIGIN",
    "COMMAND_LONG",
    "COMMAND_INT",
    "HIL_STATE_QUATERNION",
    "SIM_STATE",
    "LOCAL_POSITION_NED",
    "COMMAND_ACK",
    "TIMESYNC",
    "PING",
    "FILE_TRANSFER_PROTOCOL",
    "PARAM_REQUEST_LIST",
    "PARAM_REQUEST_READ",
    "PARAM_SET",
    "REQUEST_DATA_STREAM",
    "MISSION_REQUEST_LIST",
    "MISSION_COUNT",
    "SETUP_SIGNING",
)
COMMANDS = (179, 241, 245, 246, 410, 510, 511, 512, 520, 611, 400)
ADDRESSES = [(0, "127.0.0.1", 5000 + k) for k in range(3)] + [(0, "192.0.2.7", 14550)]
_PARSER = dialect.MAVLink(None)
_CONFIGS = {
    "auto": Config(),
    "gps2_raw": load(None, {"sources.gnss": "gps2_raw", "sources.heading": "gps_yaw"}),
    "gps_input": load(None, {"sources.gnss": "gps_input", "mavlink.max_peers": 2}),
    "hil_gps": load(None, {"sources.gnss": "hil_gps", "sources.heading": "gps_yaw"}),
    "companion": load(
        None,
        {
            "mavlink.persona": "companion",
            "mavlink.route": True,
            "autopilot_output.output": "odometry",
            "monitor.enabled": True,
        },
    ),
    "gps_raw_int": load(
        None,
        {"sources.gnss": "gps_raw_int", "sources.vertical_velocity": "global_position_int"},
    ),
}


def packet(msgid: int, payload: bytes, sysid: int, compid: int, seq: int) -> bytes:
    """An intact MAVLink 2 packet with an arbitrary payload."""
    body = payload.rstrip(b"\0") or b"\0"
    header = bytes([len(body), 0, 0, seq, sysid, compid]) + msgid.to_bytes(3, "little")
    extra = dialect.mavlink_map[msgid].crc_extra
    crc = dialect.x25crc(header + body)
    crc.accumulate(bytes([extra]))
    return b"\xfd" + header + body + crc.crc.to_bytes(2, "little")


def size_of(name: str) -> int:
    cls = getattr(dialect, f"MAVLink_{name.lower()}_message")
    return int(cls.unpacker.size)


def id_of(name: str) -> int:
    return int(getattr(dialect, f"MAVLINK_MSG_ID_{name}"))


small = st.integers(0, 255)
sysids = st.sampled_from([1, 1, 1, 2, 100, 255])


@st.composite
def arbitrary_packets(draw: st.DrawFn) -> bytes:
    name = draw(st.sampled_from(HANDLED))
    size = size_of(name)
    payload = draw(st.binary(min_size=size, max_size=size))
    compid = draw(st.sampled_from([1, 1, 1, 2, 191]))
    return packet(id_of(name), payload, draw(sysids), compid, draw(small))


numbers = st.one_of(
    st.floats(width=32), st.sampled_from([0.0, 1.0, 2.0, -1.0, 30.0, 148.0, 1e5, 47.0, 8.0])
)


@st.composite
def requests(draw: st.DrawFn) -> bytes:
    """Something that is asked of us by name, sensible or not."""
    if draw(st.booleans()):
        params = draw(st.tuples(*[numbers] * 7))
        message = dialect.MAVLink_command_long_message(
            100, 1, draw(st.sampled_from(COMMANDS)), 0, *params
        )
    else:
        name = draw(st.sampled_from([*TABLE, "NO_SUCH", ""])).encode()
        message = dialect.MAVLink_param_set_message(100, 1, name, draw(numbers), 9)
    return bytes(message.pack(dialect.MAVLink(None, 255, 190)))


@st.composite
def datagrams(draw: st.DrawFn) -> bytes:
    parts = draw(
        st.lists(
            st.one_of(arbitrary_packets(), requests(), st.binary(max_size=40)),
            min_size=1,
            max_size=4,
        )
    )
    whole = b"".join(parts)
    if draw(st.booleans()):
        whole = whole[: draw(st.integers(0, len(whole)))]
    return whole


def good(t_us: int, sysid: int = 1) -> list[bytes]:
    """What a healthy vehicle sends at t_us."""
    fix = GnssFix(t_us, 0.8, 0.1, 400.0, (0.0, 0.0, 0.0), 3, 12, 0.5, 0.8, 0.1)
    payloads = [highres_imu(ImuSample(t_us, np.array([0.0, 0.0, -9.81]), np.zeros(3)))]
    step = t_us // 20_000
    if step % 50 == 0:
        payloads.append(heartbeat(2, 0))
    if step % 10 == 0:
        payloads += [
            attitude(t_us, 0.0, 0.0, 0.5, (0.0, 0.0, 0.0)),
            gps_raw_int(fix),
            global_position_int(t_us, 0.8, 0.1, 400.0, 0.0, (0.0, 0.0, 0.0), None),
        ]
    return [frame(payload, sysid, 1, k) for k, payload in enumerate(payloads)]


class Harness:
    """A session with its own clock; every datagram that goes out is looked at."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.rows = 0
        self.now_us = 1_790_000_000_000_000
        self.session = Session(
            config,
            lambda sysid: Estimator(config, config.filter, Outputs(20_000, self.count)),
            Surroundings(
                lambda address: isinstance(address, tuple) and str(address[1]).startswith("127."),
                make_store=self.store,
            ),
        )

    def store(self, vehicle: Vehicle) -> ConfigStore:
        """Parameters that are put into force, and another filter too."""

        def apply(config: Config) -> None:
            tune(vehicle.intake, config)
            vehicle.set_rates(config.streams)

        return ConfigStore(self.config, apply, file_keeper(None))

    def count(self, block: Any, frame_n: Any) -> None:
        assert np.isfinite(block.x[: block.count]).all()
        self.rows += block.count

    def receive(self, data: bytes, address: Any, after_us: int) -> None:
        self.now_us += after_us
        self.session.receive(data, address, self.now_us)
        self.session.tick(self.now_us)
        ours = {vehicle.identity for vehicle in self.session.vehicles.values()}
        for out, _ in self.session.datagrams():
            message = _PARSER.decode(bytearray(out))
            sender = (message.get_srcSystem(), message.get_srcComponent())
            if self.config.mavlink.route and sender not in ours:
                continue  # a packet of others that is passed on as it is
            for name in message.get_fieldnames():
                value = getattr(message, name)
                for item in value if isinstance(value, list) else [value]:
                    assert not isinstance(item, float) or math.isfinite(item), message

    def start(self) -> None:
        """Three quiet seconds at the default address: the filter runs."""
        for k in range(150):
            self.receive(b"".join(good(1_000_000 + 20_000 * k)), ADDRESSES[0], 20_000)
        assert self.session.vehicles[1].estimator.running


def bounded(session: Session, config: Config) -> None:
    assert len(session.peers) <= config.mavlink.max_peers
    assert len(session.vehicles) <= config.mavlink.max_vehicles
    ours = [vehicle.identity.sysid for vehicle in session.vehicles.values()]
    assert len(set(ours)) == len(ours)


arrivals = st.lists(
    st.tuples(datagrams(), st.sampled_from(ADDRESSES), st.integers(0, 2_000_000)),
    min_size=1,
    max_size=12,
)


@given(st.sampled_from(sorted(_CONFIGS)), arrivals)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_anything_at_all_into_a_new_session(
    name: str, stream: list[tuple[bytes, Any, int]]
) -> None:
    harness = Harness(_CONFIGS[name])
    for data, address, after_us in stream:
        harness.receive(data, address, after_us)
    bounded(harness.session, harness.config)


@given(arrivals)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_anything_at_all_while_the_filter_runs(stream: list[tuple[bytes, Any, int]]) -> None:
    harness = Harness(_CONFIGS["auto"])
    harness.start()
    t_us = 4_000_000
    for data, address, after_us in stream:
        step = min(after_us, 100_000)
        harness.receive(data, address, step)
        t_us += 20_000
        harness.receive(b"".join(good(t_us)), ADDRESSES[0], 20_000)
    bounded(harness.session, harness.config)
    # and a while of quiet brings it back, whatever was believed meanwhile
    for k in range(1, 251):
        harness.receive(b"".join(good(t_us + 20_000 * k)), ADDRESSES[0], 20_000)
    assert harness.session.vehicles[1].estimator.t_us is not None


def test_more_peers_and_vehicles_than_there_is_room_for() -> None:
    config = load(None, {"mavlink.max_peers": 4, "mavlink.max_vehicles": 3})
    harness = Harness(config)
    for k in range(1, 251):
        address = (0, "127.0.0.1", 6000 + k)
        harness.receive(b"".join(good(1_000_000, sysid=k)), address, 1000)
    bounded(harness.session, config)
    assert harness.session.dropped["more peers than max_peers"] >= 240
    assert harness.session.dropped["more vehicles than max_vehicles"] >= 240
    assert len(harness.session.vehicles) == 3


def test_every_sysid_taken_still_leaves_one_for_us() -> None:
    harness = Harness(Config())
    for k in range(1, 256):
        harness.receive(frame(heartbeat(6, 8), k, 190, 0), ADDRESSES[1], 1000)
    harness.receive(good(1_000_000, sysid=7)[0], ADDRESSES[0], 1000)
    assert harness.session.vehicles[7].identity.sysid == 1 + (7 + 98) % 250
