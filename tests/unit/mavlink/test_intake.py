"""The intake: which messages become samples, fixes and headings, and when."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.feed import Between, by_turns
from mavins.estimator.settings import GnssSettings, HeadingSettings, Settings
from mavins.mavlink.codec import (
    Frames,
    Payload,
    attitude,
    fields_of,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    payload,
    scan_tlog,
    system_time,
)
from mavins.mavlink.fixes import PAIR_US
from mavins.mavlink.imu_source import CHOICE_US
from mavins.mavlink.intake import HEARTBEAT_WAIT_US, Intake
from mavins.mavlink.sources import SourceSettings
from mavins.types import GnssFix, HeadingFix, ImuSample, ImuTable, MagSample

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

UNIX_US = 1_790_000_000_000_000
GENERIC, ARDUPILOT, PX4, INVALID = 0, 3, 12, 8


class Ear:
    """Stands where the estimator stands and notes what it is fed."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.events: list[tuple[Any, ...]] = []

    def feed_imu(self, table: ImuTable) -> None:
        for k in range(len(table)):
            row = (*table.accel_b[k].tolist(), *table.gyro_b[k].tolist())
            self.events.append(("imu", int(table.t_us[k]), row))

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        by_turns(self, table, between)  # type: ignore[arg-type]

    def feed_gnss(self, fix: GnssFix) -> None:
        self.events.append(("gnss", fix))

    def feed_heading(self, fix: HeadingFix) -> None:
        self.events.append(("heading", fix))

    def feed_mag(self, sample: MagSample) -> None:
        self.events.append(("mag", sample.t_us, tuple(sample.field.tolist()), sample.source))

    def reconfigure(self, settings: Settings, filter_name: str = "") -> None:
        self.events.append(("reconfigure", (settings, filter_name)))

    def restart(self, reason: str) -> None:
        self.events.append(("restart", reason))

    def of(self, kind: str) -> list[Any]:
        return [event[1] for event in self.events if event[0] == kind]


class Line:
    """Packets with their reception stamps, on their way into an intake."""

    def __init__(self, **sources: Any) -> None:
        settings = sources.pop("settings", None)
        self.ear = Ear(settings)
        self.intake = Intake(self.ear, SourceSettings(**sources))  # type: ignore[arg-type]
        self.log: list[tuple[int, bytes]] = []

    def put(self, payload: Payload | Any, t_us: int, compid: int = 1) -> None:
        if isinstance(payload, Payload):
            packet = frame(payload, 1, compid, 0)
        else:
            packet = bytes(payload.pack(dialect.MAVLink(None, 1, compid)))
        self.log.append((UNIX_US + t_us, packet))

    def frames(self, log: list[tuple[int, bytes]] | None = None) -> Frames:
        items = self.log if log is None else log
        return scan_tlog(b"".join(t.to_bytes(8, "big") + data for t, data in items))

    def run(self) -> Ear:
        self.intake.take(self.frames())
        self.log.clear()
        return self.ear

    def start(self, autopilot: int = GENERIC) -> Line:
        """One IMU sample and a heartbeat: from here on all else is looked at."""
        self.put(imu(1_000_000), 1_000_000)
        self.put(heartbeat(2, autopilot), 1_000_000)
        self.run()
        return self


def imu(t_us: int, imu_id: int = 0, fields: int = 0x3F, x: float = 0.0) -> Payload:
    sample = ImuSample(t_us, np.array([x, 0.0, -9.8]), np.zeros(3))
    return highres_imu(sample, fields, imu_id)


def scaled(kind: str, t_us: int) -> Any:
    make = getattr(dialect, f"MAVLink_{kind.lower()}_message")
    return make(t_us if kind == "RAW_IMU" else t_us // 1000, 0, 0, -1000, 0, 0, 0, 0, 0, 0)


def raw(t_us: int, **changes: Any) -> Payload:
    values: dict[str, Any] = {
        "t_us": t_us,
        "lat": 0.8,
        "lon": 0.1,
        "alt": 400.0,
        "v_l": (3.0, 4.0, math.nan),
        "fix_type": 3,
        "satellites": 12,
        "sigma_h": 0.5,
        "sigma_v": 0.8,
        "sigma_speed": 0.1,
    }
    return gps_raw_int(GnssFix(**(values | changes)))


def second(t_us: int, **changes: Any) -> Payload:
    """GPS2_RAW with what `raw` says, field by field as GPS_RAW_INT has it."""
    first = raw(t_us, **changes)
    fields = fields_of("GPS_RAW_INT")
    named = zip(fields.names, fields.unpacker.unpack(first.body), strict=True)
    return payload(fields_of("GPS2_RAW"), **dict(named), dgps_age=7_000, dgps_numch=3)


def place(t_us: int, v_d: float = 1.0) -> Payload:
    return global_position_int(t_us, 0.8, 0.1, 400.0, 0.0, (3.0, 4.0, v_d), None)


def heading(t_us: int, yaw: float = 0.5) -> Payload:
    return attitude(t_us, 0.0, 0.0, yaw, (0.0, 0.0, 0.0))


class TestImu:
    def test_the_best_message_is_taken_at_once(self) -> None:
        line = Line()
        line.put(scaled("RAW_IMU", 1_000_000), 1_000_000)
        line.put(imu(1_001_000), 1_001_000)
        line.put(scaled("RAW_IMU", 1_002_000), 1_002_000)
        line.put(imu(1_003_000), 1_003_000)
        assert line.run().of("imu") == [1_001_000, 1_003_000]
        assert line.intake.imu.name == "HIGHRES_IMU"
        assert line.intake.dropped["IMU not chosen yet"] == 1

    @pytest.mark.parametrize("kind", ["SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU"])
    def test_a_lesser_one_after_a_second(self, kind: str) -> None:
        line = Line()
        stamps = range(1_000_000, 2_300_000, 100_000)
        for t_us in stamps:
            line.put(scaled(kind, t_us), t_us)
        taken = line.run().of("imu")
        assert taken == [t for t in stamps if t - 1_000_000 > CHOICE_US]
        assert line.intake.imu.name == kind
        # chosen once: what comes later and is better changes nothing
        line.put(imu(2_400_000), 2_400_000)
        line.put(scaled(kind, 2_500_000), 2_500_000)
        assert line.run().of("imu")[-1] == 2_500_000
        assert 2_400_000 not in line.ear.of("imu")

    def test_one_sensor_and_one_component_only(self) -> None:
        line = Line().start()
        line.put(imu(1_004_000, imu_id=1), 1_004_000)
        line.put(imu(1_008_000, fields=0x1C0), 1_008_000)
        line.put(imu(1_012_000, x=1e6), 1_012_000)
        line.put(imu(1_016_000), 1_016_000, compid=191)
        line.put(imu(1_020_000), 1_020_000)
        assert line.run().of("imu") == [1_000_000, 1_020_000]
        assert line.intake.dropped["IMU of another id"] == 1
        assert line.intake.dropped["IMU invalid"] == 2

    def test_a_reboot_starts_over_and_voids_what_was_kept(self) -> None:
        line = Line().start(PX4)
        line.put(raw(1_000_000), 1_000_000)
        for k in range(4):
            line.put(imu(900_000_000 + k * 4000), 2_000_000 + k * 4000)
        line.put(imu(900_020_000), 2_020_000)
        line.run()
        for k in range(4):
            line.put(imu(500_000 + k * 4000), 3_000_000 + k * 4000)
        line.put(raw(512_000), 3_012_000)
        ear = line.run()
        assert ear.of("restart") == ["the vehicle has rebooted"]
        assert line.intake.reboots == 1
        after = ear.events[[e[0] for e in ear.events].index("restart") + 1 :]
        assert [e[1] for e in after if e[0] == "imu"] == [508_000, 512_000]
        assert ear.of("gnss")[-1].t_us == 512_000


class TestSources:
    @pytest.mark.parametrize(
        ("autopilot", "gnss", "rate", "delay"),
        [
            (PX4, "gps_raw_int", 5.0, 0.0),
            (ARDUPILOT, "gps_raw_int", 5.0, 0.14),
            (GENERIC, "global_position_int", None, 0.0),
            (INVALID, "global_position_int", None, 0.0),
        ],
    )
    def test_by_the_autopilot(
        self, autopilot: int, gnss: str, rate: float | None, delay: float
    ) -> None:
        sources = Line().start(autopilot).intake.sources
        assert sources is not None
        assert (sources.gnss, sources.heading_rate, sources.gnss_delay) == (gnss, rate, delay)

    def test_without_a_heartbeat_raw_sensors_are_assumed(self) -> None:
        line = Line()
        line.put(imu(1_000_000), 1_000_000)
        line.put(raw(1_000_000), 1_000_000)
        assert line.run().of("gnss") == []
        assert line.intake.dropped["GPS_RAW_INT before HEARTBEAT"] == 1
        line.put(imu(1_400_000), 1_000_000 + HEARTBEAT_WAIT_US + 1)
        line.run()
        assert line.intake.autopilot == INVALID

    def test_other_sources_and_delays_on_the_way(self) -> None:
        line = Line().start(PX4)
        line.put(raw(1_004_000), 1_004_000)
        line.run()
        tuned = Settings(
            gnss=GnssSettings(delay=0.18), heading=HeadingSettings(max_rate=2.0, delay=0.05)
        )
        line.intake.reconfigure(tuned, "iekf", SourceSettings(heading="off"))
        line.put(raw(1_204_000), 1_204_000)
        line.put(heading(1_204_000), 1_204_000)
        ear = line.run()
        assert [fix.delay for fix in ear.of("gnss")] == [0.0, 0.18]
        assert ear.of("heading") == []
        assert ear.of("reconfigure") == [(tuned, "iekf")]
        line.intake.reconfigure(tuned, "iekf", SourceSettings())
        line.put(heading(1_304_000), 1_304_000)
        assert [h.delay for h in line.run().of("heading")] == [0.05]
        assert line.intake.sources is not None
        assert line.intake.sources.heading_rate == 2.0

    def test_sources_that_change_before_the_autopilot_is_known(self) -> None:
        line = Line()
        line.intake.reconfigure(Settings(), "eskf", SourceSettings(gnss="gps_input"))
        assert line.intake.sources is None
        assert line.start(PX4).intake.sources is not None
        assert line.intake.sources.gnss == "gps_input"

    def test_another_component_has_no_say(self) -> None:
        line = Line().start(PX4)
        line.put(heartbeat(18, GENERIC), 1_010_000, compid=191)
        line.put(raw(1_010_000), 1_010_000, compid=191)
        line.put(heading(1_010_000), 1_010_000, compid=191)
        ear = line.run()
        assert line.intake.autopilot == PX4
        assert ear.of("gnss") == ear.of("heading") == []

    def test_gps_raw_int_of_an_autopilot(self) -> None:
        line = Line().start(PX4)
        line.put(place(1_000_000), 1_000_000)
        line.put(raw(1_004_000), 1_004_000)
        line.put(raw(1_008_000, v_l=None), 1_008_000)
        first, second = line.run().of("gnss")
        assert first.source == "GPS_RAW_INT"
        assert first.v_l[:2] == pytest.approx((3.0, 4.0), abs=0.01)
        assert math.isnan(first.v_l[2])
        assert (first.fix_type, first.satellites) == (3, 12)
        assert (first.sigma_h, first.sigma_v, first.sigma_speed) == pytest.approx((0.5, 0.8, 0.1))
        assert second.v_l is None

    def both(self, line: Line, stamps: range) -> Line:
        """Fixes of both receivers at each stamp; those of the second say 50 m more of everything."""
        for t_us in stamps:
            line.put(imu(t_us), t_us)
            line.put(raw(t_us, alt=400.0, satellites=12), t_us)
            line.put(second(t_us, alt=450.0, satellites=17), t_us)
        line.run()
        return line

    @pytest.mark.parametrize(
        ("source", "kind", "alt", "satellites"),
        [
            ("auto", "GPS_RAW_INT", 400.0, 12),
            ("gps_raw_int", "GPS_RAW_INT", 400.0, 12),
            ("gps2_raw", "GPS2_RAW", 450.0, 17),
        ],
    )
    def test_one_of_two_receivers(
        self, source: str, kind: str, alt: float, satellites: int
    ) -> None:
        stamps = range(1_004_000, 2_000_000, 200_000)
        line = self.both(Line(gnss=source).start(ARDUPILOT), stamps)
        fixes = line.ear.of("gnss")
        assert [fix.t_us for fix in fixes] == list(stamps)
        assert {(fix.source, fix.satellites) for fix in fixes} == {(kind, satellites)}
        assert fixes[0].alt == pytest.approx(alt)
        assert (fixes[0].lat, fixes[0].lon) == pytest.approx((0.8, 0.1), abs=1e-8)
        assert fixes[0].v_l[:2] == pytest.approx((3.0, 4.0), abs=0.02)
        assert (fixes[0].sigma_h, fixes[0].sigma_v, fixes[0].sigma_speed) == (0.5, 0.8, 0.1)
        assert (fixes[0].fix_type, fixes[0].delay) == (3, 0.14)
        assert line.intake.dropped.total() == 0

    def test_the_other_receiver_in_flight(self) -> None:
        line = self.both(Line().start(PX4), range(1_004_000, 2_000_000, 200_000))
        settings = line.ear.settings
        line.intake.reconfigure(settings, "eskf", SourceSettings(gnss="gps2_raw"))
        self.both(line, range(2_004_000, 3_000_000, 200_000))
        sources = [fix.source for fix in line.ear.of("gnss")]
        assert sources == ["GPS_RAW_INT"] * 5 + ["GPS2_RAW"] * 5

    def test_the_second_receiver_before_the_autopilot_is_known(self) -> None:
        line = Line(gnss="gps2_raw")
        line.put(imu(1_000_000), 1_000_000)
        line.put(second(1_000_000), 1_000_000)
        assert line.run().of("gnss") == []
        assert line.intake.dropped["GPS2_RAW before HEARTBEAT"] == 1

    def test_the_second_receiver_lends_nothing(self) -> None:
        line = Line(gnss="global_position_int").start()
        line.put(second(1_000_000), 1_000_000)
        line.put(place(1_000_000), 1_000_000)
        assert line.run().of("gnss") == []
        assert line.intake.dropped["GLOBAL_POSITION_INT without GPS_RAW_INT"] == 1

    def test_vertical_velocity_beside_it_where_asked_for(self) -> None:
        line = Line(vertical_velocity="global_position_int").start(PX4)
        line.put(place(1_000_000, v_d=-2.0), 1_000_000)
        line.put(raw(1_004_000), 1_004_000)
        line.put(raw(1_408_000), 1_408_000)
        fresh, old = line.run().of("gnss")
        assert fresh.v_l[2] == pytest.approx(-2.0)
        assert math.isnan(old.v_l[2])

    def test_global_position_int_borrows_the_accuracies(self) -> None:
        line = Line().start(GENERIC)
        line.put(place(1_000_000), 1_000_000)
        line.put(raw(1_004_000, fix_type=4), 1_004_000)
        line.put(place(1_004_000), 1_004_000)
        line.put(place(1_004_000), 1_005_000)
        line.put(place(1_200_000), 1_004_000 + PAIR_US + 1)
        (fix,) = line.run().of("gnss")
        assert (fix.source, fix.fix_type, fix.sigma_h) == ("GLOBAL_POSITION_INT", 4, 0.5)
        assert fix.v_l == pytest.approx((3.0, 4.0, 1.0))
        assert line.intake.last_fix is fix
        dropped = line.intake.dropped
        assert dropped["GLOBAL_POSITION_INT without GPS_RAW_INT"] == 2
        assert dropped["GLOBAL_POSITION_INT repeated stamp"] == 1

    def test_an_old_fix_that_comes_again_is_known(self) -> None:
        line = Line(gnss="gps_raw_int").start()
        for stamp in (1_000_000, 1_200_000, 1_400_000, 1_000_000, 1_200_000):
            line.put(raw(stamp), 1_400_000)
        assert len(line.run().of("gnss")) == 3
        assert line.intake.dropped["GPS_RAW_INT repeated stamp"] == 2

    @pytest.mark.parametrize("source", ["gps_input", "hil_gps"])
    def test_fixes_that_any_component_may_send(self, source: str) -> None:
        if source == "gps_input":
            message: Any = dialect.MAVLink_gps_input_message(
                1_000_000, 0, 0, 0, 0, 3, 474000000, 85000000, 500.0, 1.0, 1.0, 1.0, 2.0, 3.0, 0.2, 0.5, 0.8, 12
            )  # fmt: skip
        else:
            message = dialect.MAVLink_hil_gps_message(
                1_000_000, 3, 474000000, 85000000, 500_000, 100, 100, 0, 100, 200, 300, 65535, 12
            )
        line = Line(gnss=source).start(PX4)
        line.put(message, 1_000_000, compid=220)
        line.put(raw(1_004_000), 1_004_000)
        (fix,) = line.run().of("gnss")
        assert fix.source == source.upper()
        assert fix.v_l == pytest.approx((1.0, 2.0, 3.0))
        assert fix.alt == pytest.approx(500.0)

    def test_utc_stamps_are_brought_to_the_boot_clock(self) -> None:
        line = Line(gnss="gps_raw_int").start(ARDUPILOT)
        line.put(system_time(UNIX_US + 5_000_000, 1_000_000), 1_000_000)
        line.put(raw(UNIX_US + 5_003_000), 1_010_000)
        (fix,) = line.run().of("gnss")
        assert fix.t_us == 1_003_000
        assert fix.delay == 0.0  # utc_delay, not the autopilot's


class TestHeading:
    def test_every_one_of_a_sensor_and_five_a_second_of_an_estimate(self) -> None:
        for autopilot, expected in ((GENERIC, 50), (PX4, 5)):
            line = Line().start(autopilot)
            for k in range(50):
                line.put(heading(1_000_000 + 20_000 * k), 1_000_000 + 20_000 * k)
            assert len(line.run().of("heading")) == expected

    def test_two_antennas(self) -> None:
        line = Line(heading="gps_yaw").start(PX4)
        fix = GnssFix(1_000_000, 0.8, 0.1, 400.0, None, 3, 12)
        line.put(gps_raw_int(fix, yaw=1.0, sigma_yaw=0.02), 1_000_000)
        line.put(gps_raw_int(fix), 1_000_000)
        line.put(heading(1_004_000), 1_004_000)
        (found,) = line.run().of("heading")
        assert (found.yaw, found.sigma) == (
            pytest.approx(1.0, abs=1e-4),
            pytest.approx(0.02, rel=1e-4),
        )
        assert found.source == "gps_yaw"

    def test_off(self) -> None:
        line = Line(heading="off").start()
        line.put(heading(1_000_000), 1_000_000)
        assert line.run().of("heading") == []


WITH_MAGNETOMETER = Settings(magnetometer=MagnetometerSettings(enabled=True, max_rate=10.0))


def with_field(t_us: int, x: float = 0.2, fields: int = 0x1FF) -> Any:
    return dialect.MAVLink_highres_imu_message(
        t_us, 0, 0, -9.8, 0, 0, 0, x, -0.1, 0.4, 0, 0, 0, 0, fields, 0
    )


class TestMagnetometer:
    def test_goes_behind_the_sample_that_brought_it_no_oftener_than_allowed(self) -> None:
        line = Line(settings=WITH_MAGNETOMETER)
        for k in range(60):
            line.put(with_field(1_000_000 + 4000 * k), 1_000_000 + 4000 * k)
        events = line.run().events
        stamps = [event[1] for event in events if event[0] == "mag"]
        assert stamps == [1_000_000, 1_096_000, 1_192_000]
        for k, event in enumerate(events):
            if event[0] == "mag":
                assert events[k - 1][:2] == ("imu", event[1])
                assert event[2:] == (pytest.approx((0.2, -0.1, 0.4)), "HIGHRES_IMU")
        assert len(events) == 63

    def test_is_left_alone_where_the_settings_do_not_ask_for_it(self) -> None:
        line = Line()
        line.put(with_field(1_000_000), 1_000_000)
        assert [event[0] for event in line.run().events] == ["imu"]

    @pytest.mark.parametrize("none", [with_field(1_000_000, fields=0x3F), imu(1_000_000)])
    def test_a_sample_without_a_reading(self, none: Any) -> None:
        line = Line(settings=WITH_MAGNETOMETER)
        line.put(none, 1_000_000)
        line.put(with_field(1_010_000), 1_010_000)
        assert [event[0] for event in line.run().events] == ["imu", "imu", "mag"]

    def test_a_reading_that_is_no_number(self) -> None:
        line = Line(settings=WITH_MAGNETOMETER)
        line.put(with_field(1_000_000, x=math.nan), 1_000_000)
        assert [event[0] for event in line.run().events] == ["imu"]

    def test_in_milligauss(self) -> None:
        line = Line(settings=WITH_MAGNETOMETER)
        for t_us in range(1_000_000, 1_000_000 + 2 * CHOICE_US, 100_000):
            line.put(
                dialect.MAVLink_raw_imu_message(t_us, 0, 0, -1000, 0, 0, 0, 200, -100, 400), t_us
            )
        fed = [event for event in line.run().events if event[0] == "mag"]
        assert fed
        assert fed[0][2:] == ((200.0, -100.0, 400.0), "RAW_IMU")

    def test_a_reboot_voids_the_last_stamp(self) -> None:
        line = Line(settings=WITH_MAGNETOMETER)
        stamps = [*range(60_000_000, 61_000_000, 20_000), *range(1_000_000, 2_000_000, 20_000)]
        for k, t_us in enumerate(stamps):
            line.put(with_field(t_us), 60_000_000 + 20_000 * k)
        events = line.run().events
        again = [event[0] for event in events].index("restart")
        assert [event[0] for event in events[again:]].count("mag") >= 9


@pytest.mark.parametrize("settings", [None, WITH_MAGNETOMETER])
def test_the_outcome_does_not_depend_on_the_grouping(settings: Settings | None) -> None:
    """One packet at a time, a few, or all at once: the same samples, fixes and headings in the same order."""
    rng = random.Random(4)
    whole = Line(settings=settings)
    for k in range(300):
        t_us = 1_000_000 + 4000 * k
        stamp = 0 if rng.random() < 0.02 else t_us + (900_000_000 if rng.random() < 0.02 else 0)
        whole.put(imu(stamp, imu_id=int(rng.random() < 0.1)), t_us)
        if settings is not None and k % 3 == 0:
            whole.put(with_field(t_us + 2000, x=rng.random()), t_us)
        if k % 9 == 0:
            whole.put(heading(t_us), t_us)
        if k % 30 == 0:
            whole.put(raw(t_us), t_us)
            whole.put(place(t_us), t_us)
        if k == 40:
            whole.put(heartbeat(2, GENERIC), t_us)
        if k == 200:
            whole.put(system_time(UNIX_US, t_us), t_us)
    log = list(whole.log)
    expected = whole.run()
    assert len(expected.events) > 250
    for longest in (1, 7, 60):
        parts = Line(settings=settings)
        i = 0
        while i < len(log):
            n = rng.randint(1, longest)
            parts.intake.take(parts.frames(log[i : i + n]))
            i += n
        assert repr(parts.ear.events) == repr(expected.events)
        assert +parts.intake.dropped == +whole.intake.dropped
        assert parts.intake.counts == whole.intake.counts


class Watcher:
    """Wants one kind of message and notes what it is shown."""

    def __init__(self, msgid: int) -> None:
        self.msgid = msgid
        self.asked: list[int | None] = []
        self.seen: list[tuple[str, int, int]] = []

    def wants(self, msgid: int, stamp_us: int, autopilot: int | None) -> bool:
        self.asked.append(autopilot)
        return msgid == self.msgid

    def see(self, msgid: int, message: Any, t_us: int) -> None:
        self.seen.append((message.kind, message.stamp_us, t_us))

    def summary(self) -> None:
        return None


def talk(line: Line) -> None:
    """What a PX4 sends of itself: ten of each of its estimates, one of them of no use, one by a gimbal."""
    for k in range(10):
        t_us = 1_000_000 + 20_000 * (k + 1)
        line.put(imu(t_us), t_us)
        line.put(attitude(t_us, 0.1, 0.2, 0.3, (0.0, 0.0, 0.0)), t_us)
        line.put(global_position_int(t_us, 0.8, 0.1, 400.0, 0.0, (1.0, 2.0, 3.0), 0.3), t_us)
        line.put(dialect.MAVLink_local_position_ned_message(t_us // 1000, *[1.0] * 6), t_us)
    line.put(attitude(1_210_000, math.nan, 0.0, 0.0, (0.0, 0.0, 0.0)), 1_210_000, compid=154)
    line.put(global_position_int(1_220_000, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), None), 1_220_000)


@pytest.mark.parametrize(
    ("msgid", "kind"),
    [(30, "ATTITUDE"), (32, "LOCAL_POSITION_NED"), (33, "GLOBAL_POSITION_INT")],
)
@pytest.mark.parametrize("one_by_one", [False, True])
def test_a_watcher_sees_and_changes_nothing(msgid: int, kind: str, one_by_one: bool) -> None:
    line, alone, watcher = Line().start(PX4), Line().start(PX4), Watcher(msgid)
    line.intake.watcher = watcher
    for each in (line, alone):
        talk(each)
        parts = [[item] for item in each.log] if one_by_one else [each.log]
        for part in parts:
            each.intake.take(each.frames(part))
    assert watcher.seen == [
        (kind, 1_000_000 + 20_000 * k, 1_000_000 + 20_000 * k) for k in range(1, 11)
    ]
    assert set(watcher.asked) == {PX4}
    assert line.ear.events == alone.ear.events
    assert line.intake.dropped == alone.intake.dropped
    assert line.intake.counts == alone.intake.counts
