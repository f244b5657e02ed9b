"""The simulated autopilot is asked for messages, as an autopilot is."""

import dataclasses
from collections import Counter

import pytest
from pymavlink.dialects.v20 import all as dialect

from sitl import scenario
from sitl.emitter import Emitter
from sitl.simulation import Simulation

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3
HIGHRES_IMU, ATTITUDE, HIL_STATE, VERSION = 105, 30, 115, 148


class Flight:
    """A hovering simulation, a second at a time."""

    def __init__(self, **changes):
        streams = changes.pop("streams", {})
        base = scenario.load("hover")
        streams = dataclasses.replace(base.streams, **streams)
        changed = dataclasses.replace(base, streams=streams, **changes)
        self.emitter = Emitter(changed)
        self.blocks = Simulation(changed).blocks()

    def second(self):
        packets = [packet for _, packet in self.emitter.packets(next(self.blocks))]
        messages = [dialect.MAVLink(None).decode(bytearray(p)) for p in packets]
        return Counter(m.get_type() for m in messages)

    def tell(self, message, sysid=100):
        return self.hear(message.pack(dialect.MAVLink(None, sysid, 1)))

    def hear(self, data, boot_us=5_000_000):
        answers = self.emitter.answer(data, boot_us)
        return [dialect.MAVLink(None).decode(bytearray(packet)) for packet in answers]

    def command(self, number, *p, target=(1, 1)):
        params = (*p, *[0.0] * (7 - len(p)))
        return self.tell(dialect.MAVLink_command_long_message(*target, number, 0, *params))

    def result(self, number, *p):
        ack, *_ = self.command(number, *p)
        assert (ack.get_type(), ack.command) == ("COMMAND_ACK", number)
        assert (ack.target_system, ack.target_component) == (100, 1)
        return ack.result


@pytest.fixture
def flight():
    return Flight()


def test_streams_may_be_off_or_slower_at_the_start():
    flight = Flight(streams={"highres_imu": 0, "attitude": 10, "gps_raw_int": 100})
    counts = flight.second()
    assert "HIGHRES_IMU" not in counts
    assert counts["ATTITUDE"] == 10
    assert counts["GPS_RAW_INT"] == 5


@pytest.mark.parametrize(
    ("interval_us", "result", "per_second"),
    [
        (4000, ACCEPTED, 250),
        (5000, ACCEPTED, 200),
        (20_000, ACCEPTED, 50),
        (-1, ACCEPTED, 0),
        (0, ACCEPTED, 250),
        (3999, DENIED, 250),
        (-2, DENIED, 250),
        (float("nan"), DENIED, 250),
    ],
)
def test_an_interval_is_kept(flight, interval_us, result, per_second):
    assert flight.result(511, HIGHRES_IMU, interval_us) == result
    flight.second()
    assert flight.second()["HIGHRES_IMU"] == per_second


def test_a_message_that_it_does_not_have(flight):
    assert flight.result(511, 77, 1e5) == UNSUPPORTED
    assert flight.result(511, float("nan"), 1e5) == UNSUPPORTED
    assert flight.result(512, 77) == UNSUPPORTED
    assert flight.result(400, 1) == UNSUPPORTED


def test_one_message_that_is_off():
    flight = Flight(streams={"hil_state_quaternion": 0})
    assert flight.result(512, HIL_STATE) == ACCEPTED
    assert flight.second()["HIL_STATE_QUATERNION"] == 1
    assert flight.second()["HIL_STATE_QUATERNION"] == 0


@pytest.mark.parametrize("command", [(512, VERSION), (520, 1)])
def test_its_version(flight, command):
    ack, version = flight.command(*command)
    assert ack.result == ACCEPTED
    assert version.capabilities & dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2


def test_its_time(flight):
    (answer,) = flight.tell(dialect.MAVLink_timesync_message(0, 123))
    assert (answer.tc1, answer.ts1) == (5_000_000_000, 123)
    assert flight.tell(dialect.MAVLink_timesync_message(7, 123)) == []


def test_commands_for_others_and_noise(flight):
    assert flight.command(511, HIGHRES_IMU, 1e5, target=(2, 1)) == []
    assert flight.command(511, HIGHRES_IMU, 1e5, target=(1, 191)) == []
    assert flight.hear(b"\xfd\x21garbage" * 9) == []
    assert flight.second()["HIGHRES_IMU"] == 250
    assert len(flight.command(511, HIGHRES_IMU, 1e5, target=(0, 0))) == 1


def test_one_that_denies():
    flight = Flight(commands="deny")
    assert flight.result(511, HIGHRES_IMU, 20_000) == DENIED
    assert flight.result(512, VERSION) == DENIED
    assert len(flight.tell(dialect.MAVLink_timesync_message(0, 1))) == 1
    assert flight.second()["HIGHRES_IMU"] == 250


def test_one_that_ignores():
    flight = Flight(commands="ignore")
    assert flight.command(511, HIGHRES_IMU, 20_000) == []
    assert flight.tell(dialect.MAVLink_timesync_message(0, 1)) == []


def test_an_answer_is_numbered_with_the_rest(flight):
    flight.second()
    (answer,) = flight.tell(dialect.MAVLink_timesync_message(0, 123))
    (again,) = flight.tell(dialect.MAVLink_timesync_message(0, 124))
    assert (again.get_seq() - answer.get_seq()) % 256 == 1


@pytest.mark.parametrize("how", ["accept", "deny"])
def test_what_is_measured_does_not_depend_on_it(how):
    plain, asked = Flight(), Flight(commands=how, streams={"highres_imu": 0})
    asked.command(511, ATTITUDE, 100_000)
    for _ in range(2):
        ours, theirs = next(plain.blocks), next(asked.blocks)
        assert ours.imu.gyro_b.tobytes() == theirs.imu.gyro_b.tobytes()
        assert ours.fixes == theirs.fixes
