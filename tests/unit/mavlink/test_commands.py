"""Commands are acknowledged, always; what can be asked for comes after the acknowledgement."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import frame, scan
from mavins.mavlink.commands import Command, Commands
from mavins.mavlink.intake import Intake
from mavins.mavlink.microservice import Request
from mavins.mavlink.peers import Identity
from mavins.mavlink.requests import changes_state, decode_packet, is_for
from mavins.mavlink.settings import StreamSettings
from mavins.mavlink.sources import SourceSettings
from mavins.mavlink.streams import Home
from mavins.mavlink.vehicle import Holder, Vehicle

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
WITH_ESTIMATE = (30, 31, 32, 33, 49, 105, 230, 242, 331)
HERE = "here"
PLACE = (0.0, 0.0, 0.0, 0.0, 47.25, 8.5, 410.0)


@pytest.fixture
def vehicle(estimator: Any) -> Vehicle:
    intake = Intake(estimator, SourceSettings())
    return Vehicle(1, Identity(100, 1), estimator, intake, Holder("there", 0), StreamSettings())


def command(number: int, *p: float) -> Any:
    params = (*p, *[0.0] * (7 - len(p)))
    message = dialect.MAVLink_command_long_message(100, 1, number, 0, *params)
    return decode_packet(scan(message.pack(dialect.MAVLink(None, 255, 190))), 0)


def command_int(number: int, x: int, y: int, z: float, frame_id: int = 0) -> Any:
    message = dialect.MAVLink_command_int_message(
        100, 1, frame_id, number, 0, 0, 0.0, 0.0, 0.0, 0.0, x, y, z
    )
    return decode_packet(scan(message.pack(dialect.MAVLink(None, 255, 190))), 0)


def replies(message: Any, vehicle: Vehicle, trusted: bool = True) -> list[Any]:
    link = dialect.MAVLink(None)
    request = Request(message, (255, 190), HERE, trusted, 0)
    return [
        link.decode(bytearray(frame(reply.payload, 100, 1, 0)))
        for reply in Commands().answer(request, vehicle)
    ]


def answered(message: Any, vehicle: Vehicle, trusted: bool = True) -> tuple[Any, list[Any]]:
    ack, *rest = replies(message, vehicle, trusted)
    assert (ack.get_type(), ack.command) == ("COMMAND_ACK", message.command)
    assert (ack.target_system, ack.target_component) == (255, 190)
    return ack.result, rest


@pytest.mark.parametrize("msgid", [1, 148])
def test_some_things_are_known_without_an_estimate(msgid: int, vehicle: Vehicle) -> None:
    result, (message,) = answered(command(512, msgid), vehicle)
    assert result == ACCEPTED
    assert message.get_msgId() == msgid


@pytest.mark.parametrize("msgid", WITH_ESTIMATE)
def test_others_have_to_wait_for_it(msgid: int, vehicle: Vehicle, estimator: Any) -> None:
    assert answered(command(512, msgid), vehicle) == (TEMPORARILY_REJECTED, [])
    estimator.start(5_000_000)
    vehicle.home = Home.at(estimator.solution())
    result, (message,) = answered(command(512, msgid), vehicle)
    assert result == ACCEPTED
    assert message.get_msgId() == msgid


@pytest.mark.parametrize("wanted", [0, 77, -1, 1e9, math.nan, math.inf, -math.inf])
def test_what_we_do_not_have(wanted: float, vehicle: Vehicle) -> None:
    assert answered(command(512, wanted), vehicle) == (UNSUPPORTED, [])
    assert answered(command(511, wanted, 1e5), vehicle) == (UNSUPPORTED, [])
    result, (message,) = answered(command(510, wanted), vehicle)
    assert (result, message.interval_us) == (ACCEPTED, 0)


@pytest.mark.parametrize("number", [0, 22, 176, 400, 519, 65535])
def test_other_commands_are_not_supported(number: int, vehicle: Vehicle) -> None:
    assert answered(command(number, 1.0), vehicle) == (UNSUPPORTED, [])


@pytest.mark.parametrize("how", [command(520, 1), command(512, 148)])
def test_our_version_is_told(how: Any, vehicle: Vehicle) -> None:
    from mavins import __version__

    _, (message,) = answered(how, vehicle)
    version = message.flight_sw_version
    told = f"{version >> 24}.{version >> 16 & 255}.{version >> 8 & 255}"
    assert __version__.startswith(told)
    assert message.capabilities & dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2


@pytest.mark.parametrize("interval", [math.nan, math.inf, -2, 500, 0.5])
def test_an_impossible_interval_is_denied(interval: float, vehicle: Vehicle) -> None:
    assert answered(command(511, 30, interval), vehicle) == (DENIED, [])
    assert vehicle.interval_us(HERE, "attitude") == 20_000


def test_an_interval_is_set_asked_for_and_given_back(vehicle: Vehicle) -> None:
    for wanted, told in ((40_000, 40_000), (-1, -1), (0, 20_000)):
        assert answered(command(511, 30, wanted), vehicle) == (ACCEPTED, [])
        _, (message,) = answered(command(510, 30), vehicle)
        assert (message.message_id, message.interval_us) == (30, told)
        assert answered(command(512, 244, 30), vehicle)[1][0].interval_us == told
    assert vehicle.interval_us("another", "attitude") == 20_000


def test_a_whole_group_as_it_was_once_asked_for(vehicle: Vehicle) -> None:
    def ask(stream: int, rate: int, start: int = 1) -> None:
        message = dialect.MAVLink_request_data_stream_message(100, 1, stream, rate, start)
        packet = message.pack(dialect.MAVLink(None, 255, 190))
        assert replies(decode_packet(scan(packet), 0), vehicle) == []

    ask(10, 4)
    assert vehicle.interval_us(HERE, "attitude") == 250_000
    assert vehicle.interval_us(HERE, "odometry") == 40_000
    ask(0, 2)
    assert vehicle.interval_us(HERE, "odometry") == 500_000
    assert vehicle.interval_us(HERE, "local_position_ned_cov") == -1
    ask(0, 2, 0)
    assert vehicle.sent_to(HERE) == ("gps_global_origin",)
    ask(99, 4)


def test_the_origin_by_either_command(vehicle: Vehicle, estimator: Any) -> None:
    for message in (command(611, *PLACE), command_int(611, 472500000, 85000000, 410.0)):
        result, (told,) = answered(message, vehicle)
        assert result == ACCEPTED
        assert (told.get_type(), told.altitude) == ("GPS_GLOBAL_ORIGIN", 410_000)
        assert math.degrees(estimator.origins[-1].lat) == pytest.approx(47.25)
        assert math.degrees(estimator.origins[-1].lon) == pytest.approx(8.5)


@pytest.mark.parametrize(
    "place",
    [(math.nan, 8, 0), (91, 8, 0), (47, 181, 0), (47, 8, 1e6), (0, 0, 0), (47, 8, math.inf)],
)
def test_an_impossible_place_is_denied(
    place: tuple[float, float, float], vehicle: Vehicle, estimator: Any
) -> None:
    assert answered(command(611, 0, 0, 0, 0, *place), vehicle) == (DENIED, [])
    assert answered(command(179, 0, 0, 0, 0, *place), vehicle) == (DENIED, [])
    assert estimator.origins == []


def test_home_is_here_or_there(vehicle: Vehicle, estimator: Any) -> None:
    assert answered(command(179, 1), vehicle) == (TEMPORARILY_REJECTED, [])
    estimator.start(5_000_000)
    result, (told,) = answered(command(179, 1), vehicle)
    assert (result, told.get_type(), told.x) == (ACCEPTED, "HOME_POSITION", 10.0)
    result, (told,) = answered(command(179, *PLACE), vehicle)
    assert (result, told.altitude) == (ACCEPTED, 410_000)
    assert answered(command(410), vehicle)[1][0].altitude == 410_000


def test_alignment_anew_but_not_in_flight(vehicle: Vehicle, estimator: Any) -> None:
    assert answered(command(241, 1), vehicle)[0] == ACCEPTED
    assert estimator.calibrations == 1
    estimator.may_calibrate = False
    assert answered(command(241, 1), vehicle) == (TEMPORARILY_REJECTED, [])
    assert answered(command(241, 0, 1), vehicle) == (UNSUPPORTED, [])


def test_restart(vehicle: Vehicle, estimator: Any) -> None:
    assert answered(command(246, 1), vehicle)[0] == ACCEPTED
    assert estimator.reason == "restart asked for"
    assert answered(command(246, 2), vehicle) == (DENIED, [])


@pytest.mark.parametrize("number", [179, 241, 245, 246, 611])
def test_only_the_trusted_may_change_anything(
    number: int, vehicle: Vehicle, estimator: Any
) -> None:
    message = command(number, 1)
    assert changes_state(message)
    assert answered(message, vehicle, trusted=False) == (DENIED, [])
    assert (estimator.origins, estimator.calibrations) == ([], 0)


def test_reads_and_rates_change_nothing() -> None:
    assert not any(changes_state(command(number, 1)) for number in (410, 510, 511, 512, 520))


def test_places_in_other_frames_are_local() -> None:
    assert Command.of(command_int(0, 10_000, -20_000, 3.0, frame_id=1)).p[4:] == (1.0, -2.0, 3.0)


def test_whom_a_message_means() -> None:
    message = command(512, 148)
    assert is_for(message, Identity(100, 1))
    assert not is_for(message, Identity(100, 191))
    assert not is_for(message, Identity(1, 1))
