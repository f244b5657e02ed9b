"""Autopilots of a script, and what they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.config import Config
from mavins.mavlink.codec import (
    attitude,
    fields_of,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    payload,
    system_time,
)
from mavins.mavlink.session import Session
from mavins.mavlink.settings import AskingSettings, SessionSettings
from mavins.mavlink.sources import ARDUPILOT, PX4, SourceSettings
from mavins.mavlink.wishes import Wish, fix_for, wishes_of
from mavins.types import GnssFix, ImuSample

pytestmark = pytest.mark.jit

START_US = 1_790_000_000_000_000
ADDRESS = "autopilot"
GCS = "ground station"
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
IMU_ID = 105
STEP_US = 2_000
ALL = {"imu": 250.0, "gnss": 5.0, "attitude": 10.0, "position": 5.0, "time": 1.0}
ONLY_IMU = AskingSettings(gnss_rate=0, attitude_rate=0, position_rate=0, system_time_rate=0)
MESSAGES = {105: "imu", 24: "gnss", 124: "gnss2", 30: "attitude", 33: "position", 2: "time"}


class Autopilot:
    """Sends what `rates` says on a boot clock; `react` gives the results of a command, or none."""

    def __init__(
        self,
        react: Callable[[Any], list[int]] = lambda command: [ACCEPTED],
        kind: int = ARDUPILOT,
        obeys: bool = True,
        address: str = ADDRESS,
        sysid: int = 1,
        **rates: float,
    ) -> None:
        self.rates = dict.fromkeys(ALL, 0.0) | rates
        self.react = react
        self.kind = kind
        self.obeys = obeys
        self.address = address
        self.sysid = sysid
        self.boot_us = 0
        self.silent = False
        self.answers_timesync = True
        self.asked: list[tuple[int, float]] = []
        """(message, Hz) of each SET_MESSAGE_INTERVAL."""
        self.targets: list[Any] = []

    def due(self) -> list[Any]:
        """What is sent at this instant."""
        if self.silent:
            return []
        t_us, fix = self.boot_us, GnssFix(self.boot_us, 0.8, 0.1, 400.0, None, 3)
        made = {
            "imu": lambda: highres_imu(ImuSample(t_us, np.array([0.0, 0, -9.8]), np.zeros(3))),
            "gnss": lambda: gps_raw_int(fix),
            "gnss2": lambda: payload(
                fields_of("GPS2_RAW"), time_usec=t_us, fix_type=3, lat=1, lon=1
            ),
            "attitude": lambda: attitude(t_us, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)),
            "position": lambda: global_position_int(t_us, 0.8, 0.1, 4.0, 0.0, (0, 0, 0), None),
            "time": lambda: system_time(START_US + t_us, t_us),
        }
        sent = [heartbeat(2, self.kind)] if t_us % 1_000_000 == 0 else []
        for name, rate in self.rates.items():
            if rate and t_us * rate // 1e6 != (t_us - STEP_US) * rate // 1e6:
                sent.append(made[name]())
        return sent

    def hear(self, message: Any) -> list[Any]:
        """Its answers."""
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0 and self.answers_timesync:
            fields = fields_of("TIMESYNC")
            return [payload(fields, tc1=self.boot_us * 1000 + 1, ts1=message.ts1)]
        if kind != "COMMAND_LONG":
            return []
        rate = 1e6 / message.param2
        self.asked.append((int(message.param1), rate))
        self.targets.append((message.get_srcSystem(), message.target_system))
        results = self.react(message)
        if ACCEPTED in results and self.obeys:
            self.rates[MESSAGES[int(message.param1)]] = rate
        ack = fields_of("COMMAND_ACK")
        who = {"target_system": message.get_srcSystem(), "target_component": 1}
        return [payload(ack, command=511, result=result, **who) for result in results]


class Rig:
    """A session, its ground station, and autopilots on a clock of their own."""

    def __init__(
        self,
        make_estimator: Any,
        settings: AskingSettings = ONLY_IMU,
        sources: SourceSettings = SourceSettings(),  # noqa: B008
    ) -> None:
        self.now_us = START_US
        self.session = Session(
            Config(asking=settings, sources=sources), lambda sysid: make_estimator()
        )
        self.session.add_peer(GCS)
        self.texts: list[tuple[int, str]] = []
        self.late: list[tuple[int, Any, Autopilot]] = []
        self.delay_us = 0

    def run(self, seconds: float, *autopilots: Autopilot) -> None:
        """Time passes."""
        for _ in range(round(seconds * 1e6 / STEP_US)):
            for autopilot in autopilots:
                for made in autopilot.due():
                    self.receive(made, autopilot)
                autopilot.boot_us += STEP_US
            due = [item for item in self.late if item[0] <= self.now_us]
            self.late = [item for item in self.late if item[0] > self.now_us]
            for _, made, autopilot in due:
                self.receive(made, autopilot)
            if self.now_us % 50_000 == 0:
                self.session.tick(self.now_us)
            self.deliver(autopilots)
            self.now_us += STEP_US

    def receive(self, made: Any, autopilot: Autopilot) -> None:
        self.session.receive(frame(made, autopilot.sysid, 1, 0), autopilot.address, self.now_us)

    def deliver(self, autopilots: tuple[Autopilot, ...]) -> None:
        link = dialect.MAVLink(None)
        for data, to in self.session.datagrams():
            message = link.decode(bytearray(data))
            if to == GCS and message.get_type() == "STATUSTEXT":
                if message.chunk_seq:
                    severity, text = self.texts.pop()
                    self.texts.append((severity, text + message.text))
                else:
                    self.texts.append((message.severity, message.text))
            for autopilot in autopilots:
                if to == autopilot.address:
                    answers = autopilot.hear(message)
                    self.late += [
                        (self.now_us + STEP_US + self.delay_us, a, autopilot) for a in answers
                    ]

    def said(self, part: str) -> list[str]:
        return [text for _, text in self.texts if part in text]

    @property
    def remarks(self) -> tuple[str, ...]:
        return self.session.asking.remarks


@pytest.fixture
def rig(make_estimator: Any) -> Rig:
    return Rig(make_estimator)


def test_what_comes_is_never_asked_for(make_estimator: Any) -> None:
    rig, autopilot = Rig(make_estimator, AskingSettings()), Autopilot(**ALL)
    rig.run(12.0, autopilot)
    assert autopilot.asked == []
    assert rig.remarks == ()


def test_four_fifths_are_enough(rig: Rig) -> None:
    autopilot = Autopilot(imu=165.0)
    rig.run(5.0, autopilot)
    assert autopilot.asked == []


def test_an_autopilot_that_waits_to_be_asked(make_estimator: Any) -> None:
    rig, autopilot = Rig(make_estimator, AskingSettings()), Autopilot()
    rig.run(1.1, autopilot)
    assert autopilot.asked[0] == (IMU_ID, 200.0)
    assert autopilot.targets[0] == (100, 1), "before there is a vehicle"
    rig.run(12.0, autopilot)
    assert autopilot.asked == [(105, 200.0), (24, 5.0), (30, 10.0), (33, 5.0), (2, 1.0)]
    assert set(rig.session.vehicles) == {1}
    assert rig.session.vehicles[1].identity == (100, 1), "the one under which it was asked"
    assert rig.remarks == ()
    states = rig.session.asking.autopilots[1].summary()["messages"]
    assert {message["state"] for message in states.values()} == {"coming"}


def test_a_rate_of_zero_is_not_asked_for(make_estimator: Any) -> None:
    settings = AskingSettings(imu_rate=0, attitude_rate=0, position_rate=0, system_time_rate=0)
    rig, autopilot = Rig(make_estimator, settings), Autopilot()
    rig.run(5.0, autopilot)
    assert autopilot.asked == [(24, 5.0)]


def test_it_can_be_turned_off(make_estimator: Any) -> None:
    rig, autopilot = Rig(make_estimator, AskingSettings(enabled=False)), Autopilot()
    rig.run(5.0, autopilot)
    assert autopilot.asked == []
    assert rig.session.asking.autopilots == {}


@pytest.mark.parametrize("denial", [DENIED, FAILED])
def test_a_denied_rate_is_tried_slower(rig: Rig, denial: int) -> None:
    autopilot = Autopilot(lambda m: [ACCEPTED if m.param2 >= 20_000 else denial])
    rig.run(8.0, autopilot)
    assert autopilot.asked == [(IMU_ID, 200.0), (IMU_ID, 100.0), (IMU_ID, 50.0)]
    (text,) = rig.said("gives HIGHRES_IMU")
    assert "at 50 Hz, not at 200 Hz; raise SCHED_LOOP_RATE to 200 or more" in text
    assert rig.remarks == (text.removeprefix("mavins: "),)


def test_all_denied(rig: Rig) -> None:
    autopilot = Autopilot(lambda m: [DENIED])
    rig.run(10.0, autopilot)
    assert [rate for _, rate in autopilot.asked] == [200.0, 100.0, 50.0]
    assert len(rig.said("denies HIGHRES_IMU: none comes; raise SCHED_LOOP_RATE")) == 1
    assert rig.texts[0][0] == 4
    rig.run(5.0, autopilot)
    assert len(autopilot.asked) == 3


def test_no_rate_is_asked_for_that_comes_anyhow(rig: Rig) -> None:
    autopilot = Autopilot(lambda m: [DENIED], PX4, imu=100.0)
    rig.run(6.0, autopilot)
    assert [rate for _, rate in autopilot.asked] == [200.0]
    assert rig.said("denies HIGHRES_IMU: 100 of 200 Hz come; set MAV_x_MODE")


def test_a_message_that_it_does_not_have(rig: Rig) -> None:
    autopilot = Autopilot(lambda m: [UNSUPPORTED])
    rig.run(6.0, autopilot)
    assert [rate for _, rate in autopilot.asked] == [200.0]
    assert rig.said("cannot be asked for HIGHRES_IMU")


def test_one_that_does_not_answer(make_estimator: Any) -> None:
    rig, autopilot = Rig(make_estimator, AskingSettings()), Autopilot(lambda m: [])
    rig.run(10.0, autopilot)
    assert autopilot.asked == [(IMU_ID, 200.0)] * 4
    assert len(rig.said("does not answer SET_MESSAGE_INTERVAL (HIGHRES_IMU: none comes)")) == 1
    rig.run(32.0, autopilot)
    assert len(autopilot.asked) == 8, "it may hear us by now"
    assert len(rig.said("does not answer")) == 1
    autopilot.react = lambda m: [ACCEPTED]
    rig.run(50.0, autopilot)
    assert rig.remarks == ()
    assert autopilot.rates["imu"] == 200.0


def test_an_acknowledgement_that_is_lost(rig: Rig) -> None:
    def lose_the_first(message: Any) -> list[int]:
        autopilot.rates["imu"] = 200.0
        return [] if message.confirmation == 0 else [ACCEPTED]

    autopilot = Autopilot(lose_the_first)
    rig.run(8.0, autopilot)
    assert 1 <= len(autopilot.asked) <= 2
    assert (rig.remarks, rig.said("HIGHRES_IMU")) == ((), [])


def test_a_late_acknowledgement_does_not_pass_for_that_of_the_next(make_estimator: Any) -> None:
    settings = AskingSettings(attitude_rate=0, position_rate=0, system_time_rate=0)
    rig = Rig(make_estimator, settings)
    autopilot = Autopilot(lambda m: [ACCEPTED if m.param1 == IMU_ID else DENIED], obeys=False)
    rig.delay_us = 1_200_000
    rig.run(8.0, autopilot)
    assert rig.said("denies GPS_RAW_INT") or (24, 1.0) in autopilot.asked


def test_not_now_is_asked_again(rig: Rig) -> None:
    results = iter([[TEMPORARILY_REJECTED], [IN_PROGRESS, ACCEPTED]])
    autopilot = Autopilot(lambda m: next(results))
    rig.run(6.0, autopilot)
    assert [rate for _, rate in autopilot.asked] == [200.0, 200.0]
    assert rig.remarks == ()


def test_accepted_but_it_does_not_come(rig: Rig) -> None:
    autopilot = Autopilot(obeys=False, imu=50.0)
    rig.run(8.0, autopilot)
    (text,) = rig.said("has accepted HIGHRES_IMU at 200 Hz, but 50 of 200 Hz come")
    assert "HIGHRES_IMU at 200 Hz takes 14.8 kB/s: 230400 baud or more" in text
    autopilot.rates["imu"] = 200.0
    rig.run(3.0, autopilot)
    assert rig.said("HIGHRES_IMU comes now")
    assert rig.remarks == ()


@pytest.mark.parametrize("heard", [True, False])
def test_after_a_reboot_it_is_asked_again(rig: Rig, heard: bool) -> None:
    autopilot = Autopilot()
    autopilot.answers_timesync = heard
    rig.run(6.0, autopilot)
    assert len(autopilot.asked) == 1
    autopilot.boot_us, autopilot.rates["imu"] = 0, 0.0
    rig.run(6.0, autopilot)
    assert len(autopilot.asked) == 2
    assert autopilot.rates["imu"] == 200.0


def test_one_that_was_away_is_asked_again(rig: Rig) -> None:
    autopilot = Autopilot(lambda m: [DENIED])
    rig.run(5.0, autopilot)
    autopilot.silent = True
    rig.run(6.0, autopilot)
    assert rig.remarks == ()
    autopilot.silent = False
    autopilot.react = lambda m: [ACCEPTED]
    rig.run(5.0, autopilot)
    assert autopilot.rates["imu"] == 200.0


@pytest.mark.parametrize(
    ("kind", "autopilot", "compid"),
    [(6, 3, 1), (18, 8, 191), (2, 8, 1), (0, 0, 1), (26, 3, 154)],
)
def test_others_are_not_asked(rig: Rig, kind: int, autopilot: int, compid: int) -> None:
    for _ in range(40):
        rig.session.receive(frame(heartbeat(kind, autopilot), 1, compid, 0), "x", rig.now_us)
        rig.run(0.1)
    assert rig.session.asking.autopilots == {}


def test_two_ways_to_one_autopilot_and_two_autopilots(rig: Rig) -> None:
    first, twice, other = Autopilot(), Autopilot(address="relay"), Autopilot(sysid=2)
    rig.run(8.0, first, twice, other)
    assert first.asked == [(IMU_ID, 200.0)] * 2, "two autopilots at one address"
    assert sorted(target for _, target in first.targets) == [1, 2]
    assert twice.asked == []


def test_an_answer_for_somebody_else_is_none(rig: Rig) -> None:
    autopilot = Autopilot(lambda m: [])
    rig.run(1.2, autopilot)
    ack = fields_of("COMMAND_ACK")
    assert len(autopilot.asked) == 1
    for foreign in (
        payload(ack, command=511, result=DENIED, target_system=255, target_component=190),
        payload(ack, command=512, result=DENIED),
    ):
        rig.receive(foreign, autopilot)
    rig.run(0.5, autopilot)
    assert len(autopilot.asked) == 1
    rig.receive(payload(ack, command=511, result=DENIED), autopilot)
    rig.run(0.1, autopilot)
    assert autopilot.asked[1] == (IMU_ID, 100.0), "an old autopilot names no target"


def test_fake_autopilots_do_not_fill_the_memory(rig: Rig) -> None:
    for sysid in range(1, 251):
        rig.session.receive(frame(heartbeat(2, 3), sysid, 1, 0), "flood", rig.now_us)
    assert len(rig.session.asking.autopilots) == SessionSettings().max_vehicles
    rig.run(4.0)
    assert rig.session.asking.autopilots == {}


def test_our_own_words_that_come_back_are_nobodys(rig: Rig) -> None:
    autopilot = Autopilot()
    rig.run(0.2, autopilot)
    for msgid in ("COMMAND_LONG", "TIMESYNC", "STATUSTEXT"):
        echo = frame(payload(fields_of(msgid)), 100, 1, 0)
        rig.session.receive(echo, "other way", rig.now_us)
    rig.run(4.0, autopilot)
    assert rig.session.vehicles[1].identity == (100, 1)


def test_the_offset_of_the_clocks(rig: Rig) -> None:
    autopilot = Autopilot(imu=250.0)
    rig.run(5.0, autopilot)
    timesync = rig.session.asking.autopilots[1].timesync
    assert timesync.offset == pytest.approx(START_US * 1e-6, abs=0.01)
    assert timesync.round_trip is not None
    assert 0.0 <= timesync.round_trip <= 0.01


def test_a_slow_simulation_keeps_its_own_rates(rig: Rig) -> None:
    autopilot = Autopilot(imu=250.0)
    for _ in range(30):  # every second tenth of a second it stands still
        rig.run(0.1, autopilot)
        rig.run(0.1)
    assert autopilot.asked == []


def test_the_receiver_that_is_used_is_asked_for(make_estimator: Any) -> None:
    settings = AskingSettings(attitude_rate=0, position_rate=0, system_time_rate=0)
    rig = Rig(make_estimator, settings, SourceSettings(gnss="gps2_raw"))
    autopilot = Autopilot(**(ALL | {"gnss": 5.0, "gnss2": 1.0}))
    rig.run(8.0, autopilot)
    assert autopilot.asked == [(124, 5.0)]
    assert autopilot.rates["gnss2"] == 5.0
    summary = rig.session.asking.autopilots[1].summary()
    assert summary["messages"]["GPS2_RAW"]["state"] == "coming"
    assert "GPS_RAW_INT" not in summary["messages"]


def test_intervals_are_whole_milliseconds() -> None:
    wishes = wishes_of(AskingSettings(imu_rate=300.0))
    assert [wish.name for wish in wishes][:2] == ["HIGHRES_IMU", "GPS_RAW_INT"]
    assert wishes[0].rates == (300.0, 250.0, 200.0, 100.0, 50.0)
    request = dialect.MAVLink(None).decode(bytearray(frame(wishes[0].request(7, 2), 1, 1, 0)))
    assert (request.command, request.param1, request.param2) == (511, 105.0, 3000.0)
    assert (request.target_system, request.target_component, request.confirmation) == (7, 1, 2)


@pytest.mark.parametrize(
    ("kind", "name", "rate", "parts"),
    [
        (ARDUPILOT, "HIGHRES_IMU", 250.0, ["SCHED_LOOP_RATE to 250", "18.5 kB/s: 230400 baud"]),
        (ARDUPILOT, "GPS_RAW_INT", 5.0, ["SRx_EXT_STAT", "receiver"]),
        (ARDUPILOT, "GPS2_RAW", 5.0, ["SRx_EXT_STAT", "receiver"]),
        (PX4, "HIGHRES_IMU", 100.0, ["mavlink stream -s HIGHRES_IMU -r 100", "115200 baud"]),
        (0, "ATTITUDE", 10.0, ["rate of ATTITUDE"]),
    ],
)
def test_the_fix_is_named(kind: int, name: str, rate: float, parts: list[str]) -> None:
    text = fix_for(kind, Wish(name, (rate,), name == "HIGHRES_IMU"))
    assert all(part in text for part in parts), text
