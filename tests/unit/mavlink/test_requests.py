"""Commands are acknowledged, always; what can be asked for comes after the acknowledgement."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.mavlink.codec import frame, scan
from mavins.mavlink.intake import Intake
from mavins.mavlink.requests import answer, decode_packet
from mavins.mavlink.settings import StreamSettings
from mavins.mavlink.sources import SourceSettings
from mavins.mavlink.streams import Home
from mavins.mavlink.vehicle import Holder, Vehicle

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

ACCEPTED, TEMPORARILY_REJECTED, UNSUPPORTED = 0, 1, 3
WITH_ESTIMATE = (30, 31, 32, 33, 49, 230, 242, 331)


@pytest.fixture
def vehicle(estimator: Any) -> Vehicle:
    intake = Intake(estimator, SourceSettings())
    return Vehicle(1, 100, estimator, intake, Holder("there", 0), StreamSettings())


def command(number: int, param1: float = 0.0) -> Any:
    message = dialect.MAVLink_command_long_message(100, 1, number, 0, param1, 0, 0, 0, 0, 0, 0)
    return decode_packet(scan(message.pack(dialect.MAVLink(None, 255, 190))), 0)


def answered(message: Any, vehicle: Vehicle) -> tuple[Any, list[Any]]:
    link = dialect.MAVLink(None)
    ack, *rest = [
        link.decode(bytearray(frame(p, 100, 1, 0))) for p in answer(message, (255, 190), vehicle)
    ]
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


@pytest.mark.parametrize("number", [0, 22, 176, 400, 511, 519, 611, 65535])
def test_other_commands_are_not_supported(number: int, vehicle: Vehicle) -> None:
    assert answered(command(number, 1.0), vehicle) == (UNSUPPORTED, [])


def test_our_version_is_told(vehicle: Vehicle) -> None:
    from mavins import __version__

    _, (message,) = answered(command(512, 148), vehicle)
    version = message.flight_sw_version
    told = f"{version >> 24}.{version >> 16 & 255}.{version >> 8 & 255}"
    assert __version__.startswith(told)
    assert message.capabilities & dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
