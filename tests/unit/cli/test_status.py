"""The live status: what it says, at which pace, and that JSON stays JSON."""

from __future__ import annotations

import dataclasses
import io
import json
import math

import pytest

from mavins.cli.status import make_renderer, to_plain, to_svg
from mavins.status import (
    AidingStatus,
    EstimateStatus,
    StatusSnapshot,
    TruthError,
    VehicleStatus,
    from_json,
    to_json,
)

ESTIMATE = EstimateStatus(
    lat_deg=47.3977419,
    lon_deg=8.5455938,
    alt=488.13,
    p_n=(12.345, -3.2, -10.05),
    sd_p=(0.012, 0.013, 0.02),
    v_l=(1.2, -3.4, 0.05),
    sd_v=(0.01, 0.011, 0.02),
    attitude=(0.1, -0.02, math.pi / 2),
    sd_attitude=(0.001, 0.001, 0.004),
)
VEHICLE = VehicleStatus(
    sysid=1,
    health="running",
    reason="yaw not observable",
    t_us=5_000_000,
    estimate=ESTIMATE,
    rates={"imu": 249.7, "gnss": 5.0},
    aidings={
        "gnss_position": AidingStatus(123, {"gate": 2, "too old": 1}, 2.8, 3.0, 0.97),
        "heading": AidingStatus(),
    },
    reset_counter=1,
    error=TruthError((0.03, 0.0, 0.04), (0.01, 0.0, 0.0), (0.0, 0.0, math.radians(0.5))),
)
SNAPSHOT = StatusSnapshot(12.0, 2, 3210, 4567, {"wrong CRC": 2}, (VEHICLE,))


def at(uptime: float) -> StatusSnapshot:
    return dataclasses.replace(SNAPSHOT, uptime=uptime)


def test_plain_is_one_line_with_everything_that_matters() -> None:
    line = to_plain(SNAPSHOT)
    assert "\n" not in line
    for part in (
        "vehicle 1: running (yaw not observable)",
        "p 12.35 -3.20 -10.05 m",
        "90.0 deg",
        "imu 250 Hz",
        "rejected 3",
        "error 0.050 m, 0.010 m/s, 0.50 deg",
    ):
        assert part in line


def test_plain_without_a_vehicle_says_what_is_waited_for() -> None:
    line = to_plain(StatusSnapshot(3.0, 1, 20, 5))
    assert line == "     3 s  waiting for a vehicle's IMU; 1 peer, 20 packets in, 5 out"


def test_json_comes_back_as_it_was() -> None:
    assert from_json(to_json(SNAPSHOT)) == SNAPSHOT
    bare = StatusSnapshot(0.0, 0, 0, 0, {}, (VehicleStatus(2, "waiting", "no IMU", 0),))
    assert from_json(to_json(bare)) == bare


def test_json_never_holds_nan_or_infinity() -> None:
    vehicle = dataclasses.replace(
        VEHICLE,
        estimate=dataclasses.replace(ESTIMATE, alt=math.nan, sd_p=(math.inf, 1.0, -math.inf)),
        rates={"imu": math.inf},
    )
    line = to_json(dataclasses.replace(SNAPSHOT, vehicles=(vehicle,)))
    assert "NaN" not in line
    assert "Infinity" not in line
    assert json.loads(line)["vehicles"][0]["estimate"]["sd_p"] == [None, 1.0, None]
    back = from_json(line).vehicles[0].estimate
    assert back is not None
    assert math.isnan(back.alt)


@pytest.mark.parametrize("line", ["", "{", "[]", "{}", '{"vehicles": [1]}', '{"vehicles": []}'])
def test_what_is_no_status_line_is_a_value_error(line: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        from_json(line)


def test_lines_come_once_a_second_however_often_updated() -> None:
    out = io.StringIO()
    renderer = make_renderer("json", out)
    for tenth in range(31):
        renderer.update(at(tenth / 10))
    renderer.close()
    uptimes = [json.loads(line)["uptime"] for line in out.getvalue().splitlines()]
    assert uptimes == [0.0, 1.0, 2.0, 3.0]


def test_auto_is_plain_without_a_terminal() -> None:
    out = io.StringIO()
    renderer = make_renderer("auto", out)
    renderer.update(SNAPSHOT)
    assert out.getvalue() == to_plain(SNAPSHOT) + "\n"


def test_off_says_nothing() -> None:
    out = io.StringIO()
    renderer = make_renderer("off", out)
    renderer.update(SNAPSHOT)
    renderer.close()
    assert out.getvalue() == ""


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_gets_the_panel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "40")
    monkeypatch.setenv("TERM", "xterm")
    out = _Terminal()
    renderer = make_renderer("auto", out)
    renderer.update(SNAPSHOT)
    renderer.update(StatusSnapshot(13.0, 0, 0, 0))
    renderer.close()
    for part in ("RUNNING", "gate 2, too old 1", "resets 1", "waiting for a vehicle's IMU"):
        assert part in out.getvalue()


@pytest.mark.parametrize("metres", [0.0, -999.99, -12345.678, 1e9])
def test_the_panels_lines_hold_at_any_distance(metres: float) -> None:
    from rich.console import Console

    from mavins.cli.status import to_panel

    far = dataclasses.replace(ESTIMATE, p_n=(metres,) * 3, sd_p=(abs(metres),) * 3)
    vehicle = dataclasses.replace(VEHICLE, estimate=far)
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(to_panel(dataclasses.replace(SNAPSHOT, vehicles=(vehicle,))))
    assert len(console.export_text().splitlines()) == 17


def test_the_picture_is_svg_that_needs_nothing_from_elsewhere() -> None:
    svg = to_svg(SNAPSHOT)
    assert svg.startswith("<svg")
    assert "RUNNING" in svg
    assert "url(" not in svg.replace("url(#", "")


def test_biases_and_gravity_are_shown_where_they_are_estimated() -> None:
    estimate = dataclasses.replace(
        ESTIMATE,
        baro_bias=1.25,
        sd_baro_bias=0.5,
        mag_bias=(0.1, -0.2, 0.05),
        sd_mag_bias=(0.01, 0.02, 0.03),
        gravity=(math.radians(0.6), math.radians(-0.8)),
        sd_gravity=(math.radians(0.1), math.radians(0.2)),
    )
    vehicle = dataclasses.replace(VEHICLE, estimate=estimate)
    snapshot = dataclasses.replace(SNAPSHOT, vehicles=(vehicle,))
    line = to_plain(snapshot)
    assert "baro bias 1.25 m (±0.50)" in line
    assert "mag bias 0.100 -0.200 0.050 (±0.010/0.020/0.030)" in line
    assert "gravity 0.60 -0.80 deg (±0.10/0.20)" in line
    assert from_json(to_json(snapshot)) == snapshot
