"""MAVSDK 4: what it reads of a vehicle that flies is what the service sent, and each of its requests is answered."""

from __future__ import annotations

import importlib.util
import itertools
import json
from collections.abc import Callable
from typing import Any

import pytest

from mavins import __version__
from mavins.parameters import TABLE

pytestmark = [
    pytest.mark.slow,
    pytest.mark.jit,
    pytest.mark.skipif(
        importlib.util.find_spec("mavsdk") is None,
        reason="client mavsdk is not installed (the extra 'acceptance')",
    ),
]

SYSID = 100
PARAMETER = "GNSS_GATE"
SAMPLE_US = 4000
"""Of the simulator's IMU, on which estimates are sent."""

Events = list[dict[str, Any]]


def values(events: Events, kind: str, stream: str) -> list[Any]:
    return [e["value"] for e in events if e["kind"] == kind and e["stream"] == stream]


def outcome(events: Events, kind: str) -> dict[str, Any]:
    (event,) = (e for e in events if e["kind"] == kind)
    return event


def nothing_is_repeated(tap: Any) -> None:
    """No request is without an answer: a client that has none asks the same twice a second."""
    tap.wait_until(lambda tap: not tap.unanswered())
    too_often = {key: n for key, n in tap.requests().items() if n > 5}
    assert too_often == {}


# ---- telemetry -----------------------------------------------------------------------------------------------------


NUMBERS: dict[str, tuple[str, Callable[[Any], Any], Callable[[Any], Any]]] = {
    "position_velocity_ned": (
        "LOCAL_POSITION_NED",
        lambda v: (*v["position"].values(), *v["velocity"].values()),
        lambda m: (m.x, m.y, m.z, m.vx, m.vy, m.vz),
    ),
    "attitude_quaternion": (
        "ATTITUDE_QUATERNION",
        lambda v: (v["w"], v["x"], v["y"], v["z"], v["timestamp_us"]),
        lambda m: (m.q1, m.q2, m.q3, m.q4, m.time_boot_ms * 1000),
    ),
    "odometry": (
        "ODOMETRY",
        lambda v: (
            v["time_usec"],
            *v["position_body"].values(),
            *v["velocity_body"].values(),
            v["q"]["w"],
            v["q"]["z"],
            *v["pose_covariance"]["covariance_matrix"],
            *v["velocity_covariance"]["covariance_matrix"],
        ),
        lambda m: (
            *(m.time_usec, m.x, m.y, m.z, m.vx, m.vy, m.vz, m.q[0], m.q[3]),
            *m.pose_covariance,
            *m.velocity_covariance,
        ),
    ),
    "imu": (
        "HIGHRES_IMU",
        lambda v: (
            v["timestamp_us"],
            *v["acceleration_frd"].values(),
            *v["angular_velocity_frd"].values(),
        ),
        lambda m: (m.time_usec, m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro),
    ),
    "raw_gps": (
        "GPS_RAW_INT",
        lambda v: (
            v["timestamp_us"],
            round(v["latitude_deg"] * 1e7),
            round(v["longitude_deg"] * 1e7),
            round(v["absolute_altitude_m"] * 1e3),
            round(v["horizontal_uncertainty_m"] * 1e3),
        ),
        lambda m: (m.time_usec, m.lat, m.lon, m.alt, m.h_acc),
    ),
    "position": (
        "GLOBAL_POSITION_INT",
        lambda v: (
            round(v["latitude_deg"] * 1e7),
            round(v["longitude_deg"] * 1e7),
            round(v["absolute_altitude_m"] * 1e3),
            round(v["relative_altitude_m"] * 1e3),
        ),
        lambda m: (m.lat, m.lon, m.alt, m.relative_alt),
    ),
    "home": (
        "HOME_POSITION",
        lambda v: (
            v["timestamp_us"],
            round(v["latitude_deg"] * 1e7),
            round(v["longitude_deg"] * 1e7),
        ),
        lambda m: (m.time_usec, m.latitude, m.longitude),
    ),
}
"""Stream -> the message that it comes from, and the numbers that both must agree on."""
AT_LEAST = {
    "position_velocity_ned": 200,
    "velocity_ned": 40,
    "position": 40,
    "heading": 40,
    "attitude_euler": 200,
    "attitude_quaternion": 200,
    "attitude_angular_velocity_body": 200,
    "odometry": 100,
    "imu": 40,
    "raw_gps": 20,
    "gps_info": 20,
    "home": 2,
    "health": 3,
    "health_all_ok": 3,
}


def test_it_reads_what_was_sent(tap: Callable[[], Any], client: Callable[..., Any]) -> None:
    line = tap()
    events = client("mavsdk_client.py", f"udpout://127.0.0.1:{line.port}", "telemetry").events(60.0)
    assert events[-1]["kind"] == "done"
    for stream, least in AT_LEAST.items():
        assert len(values(events, "stream", stream)) >= least, stream
    for stream, (kind, of_value, of_message) in NUMBERS.items():
        sent = {of_message(message) for _, message in line.from_service(kind)}
        read = {of_value(value) for value in values(events, "stream", stream)}
        assert read <= sent, (stream, sorted(read - sent)[:2], sorted(sent)[:2])
    # the first may come before the home position
    assert values(events, "stream", "health_all_ok")[-1] is True
    assert {v["fix_type"] for v in values(events, "stream", "gps_info")} == {"FIX_3D"}
    the_vehicle_names_itself(events, line)
    rates_are_as_asked(events, line)
    nothing_is_repeated(line)
    assert line.lost() == 0


def the_vehicle_names_itself(events: Events, line: Any) -> None:
    origin = outcome(events, "origin")["value"]
    sent = {(m.latitude, m.longitude) for _, m in line.from_service("GPS_GLOBAL_ORIGIN")}
    assert (round(origin["latitude_deg"] * 1e7), round(origin["longitude_deg"] * 1e7)) in sent
    version = outcome(events, "version")["value"]
    ours = [int(part) for part in __version__.split("+")[0].split(".")[:3]]
    assert [version[f"flight_sw_{part}"] for part in ("major", "minor", "patch")] == ours
    assert outcome(events, "identification")["value"]["legacy_uid"] == SYSID
    assert "value" in outcome(events, "product")


def rates_are_as_asked(events: Events, line: Any) -> None:
    """The service acknowledges each, and from then on the stamps lie so far apart."""
    heard = [message for _, message in line.from_service()]
    acks = [i for i, m in enumerate(heard) if m.get_type() == "COMMAND_ACK" and m.command == 511]
    after = heard[acks[-1] :]
    for stream, kind, period_us, stamp in (
        ("attitude_quaternion", "ATTITUDE_QUATERNION", 200_000, lambda m: m.time_boot_ms * 1000),
        ("position_velocity_ned", "LOCAL_POSITION_NED", 100_000, lambda m: m.time_boot_ms * 1000),
        ("odometry", "ODOMETRY", 250_000, lambda m: m.time_usec),
        ("home", "HOME_POSITION", 500_000, lambda m: m.time_usec),
    ):
        assert outcome(events, f"rate {stream}")["value"] == "SUCCESS"
        stamps = [stamp(m) for m in after if m.get_type() == kind]
        assert len(stamps) > 5, kind
        periods = [b - a for a, b in itertools.pairwise(stamps)]
        assert periods == pytest.approx([period_us] * len(periods), abs=SAMPLE_US), kind
        assert values(events, "rated", stream), stream
    refused = outcome(events, "rate battery")
    assert refused["failed"] == "UNSUPPORTED"
    assert refused["took"] < 2.5


# ---- parameters ----------------------------------------------------------------------------------------------------


def test_it_lists_and_sets_parameters(tap: Callable[[], Any], client: Callable[..., Any]) -> None:
    line = tap()
    url = f"udpout://127.0.0.1:{line.port}"
    events = client("mavsdk_client.py", url, "parameters", PARAMETER).events(60.0)
    listed = outcome(events, "all")["value"]
    assert listed["int_params"] == listed["custom_params"] == []
    found = {one["name"]: one["value"] for one in listed["float_params"]}
    assert set(found) == set(TABLE)
    usual = found[PARAMETER]
    assert "failed" not in outcome(events, "set")
    assert outcome(events, "half")["value"] == pytest.approx(0.5 * usual)
    assert outcome(events, "whole")["value"] == usual
    assert outcome(events, "refused")["failed"] == "VALUE_OUT_OF_RANGE"
    unknown = outcome(events, "unknown")
    assert unknown["failed"] == "DOES_NOT_EXIST"
    # without an answer it asks again for three seconds
    assert unknown["took"] < 2.5
    nothing_is_repeated(line)
    assert line.lost() == 0


def test_it_learns_what_the_parameters_are(
    tap: Callable[[], Any], client: Callable[..., Any]
) -> None:
    line = tap()
    url = f"udpout://127.0.0.1:{line.port}"
    events = client("mavsdk_client.py", url, "metadata").events(60.0)
    described = json.loads(outcome(events, "found")["value"]["json_metadata"])
    assert [one["name"] for one in described["parameters"]] == list(TABLE)
    for burst in (True, False):
        (read,) = (e["text"] for e in events if e["kind"] == "file" and e["burst"] is burst)
        assert json.loads(read) == described
        assert outcome(events, f"same {burst}")["value"] is True
    nothing_is_repeated(line)
    assert line.lost() == 0
