"""A ground station of the outside world: a MAVSDK client reads position and attitude while the simulator flies."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.nav.earth import dcm_ne, lla_to_ecef
from mavins.nav.so3 import quat_to_euler, wrap_pi
from sitl import scenario
from sitl.simulation import Simulation

pytestmark = [
    pytest.mark.slow,
    pytest.mark.jit,
    pytest.mark.skipif(
        importlib.util.find_spec("mavsdk") is None, reason="client mavsdk is not installed"
    ),
]

SECONDS = 22.0

CLIENT = """
import asyncio, json, sys, time

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync


def say(kind, **values):
    print(json.dumps({"kind": kind, **values}), flush=True)


async def positions(telemetry):
    async for both in telemetry.subscribe_position_velocity_ned():
        p, v = both.position, both.velocity
        say("position", p=[p.north_m, p.east_m, p.down_m], v=[v.north_m_s, v.east_m_s, v.down_m_s])


async def attitudes(telemetry):
    async for angle in telemetry.subscribe_attitude_euler():
        angles = [angle.roll_deg, angle.pitch_deg, angle.yaw_deg]
        say("attitude", t_us=angle.timestamp_us, deg=angles)


async def healths(telemetry):
    async for good in telemetry.subscribe_health_all_ok():
        say("health", good=bool(good))


async def origin(telemetry):
    while True:
        try:
            at = await telemetry.get_gps_global_origin()
            say("origin", lat=at.latitude_deg, lon=at.longitude_deg, alt=at.altitude_m)
            return
        except Exception as error:
            say("no origin yet", error=str(error))
            await asyncio.sleep(1.0)


async def main(url, seconds):
    kind = ComponentType.GROUND_STATION
    mavsdk = Mavsdk(Configuration.create_with_component_type(kind))
    await mavsdk.add_any_connection(url)
    say("listening")
    system = await mavsdk.first_autopilot(30.0)
    if system is None:
        sys.exit("no autopilot seen")
    say("connected")
    telemetry = TelemetryAsync(system)
    readers = [f(telemetry) for f in (positions, attitudes, healths, origin)]
    try:
        await asyncio.wait_for(asyncio.gather(*readers), seconds)
    except asyncio.TimeoutError:
        say("done")


asyncio.run(asyncio.wait_for(main(sys.argv[1], float(sys.argv[2])), float(sys.argv[2]) + 40.0))
"""


def free_port() -> int:
    """A port that nobody has, and that nobody gets who asks for any."""
    for port in range(20_000 + os.getpid() % 10_000, 32_000):
        with contextlib.suppress(OSError), socket.socket(type=socket.SOCK_DGRAM) as sock:
            sock.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no port is free")


def tangent_plane(origin: Any) -> tuple[Any, Any]:
    """Axes (3, 3) and base point (3,) of the scenario's tangent plane."""
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    return dcm_ne(lat, lon), lla_to_ecef(lat, lon, origin.alt)


def flown(seconds: float) -> tuple[Any, Any, Any, Any]:
    """The simulator's truth: t_us (N,), place in the scenario's tangent plane (N, 3), velocity (N, 3), Euler (N, 3)."""
    one = scenario.load("quad_mission")
    C_ne, base = tangent_plane(one.origin)
    rows = []
    for block in Simulation(one, 0).blocks():
        for state in block.states:
            truth = state.sample
            place = C_ne @ (lla_to_ecef(truth.lat, truth.lon, truth.alt) - base)
            rows.append([truth.t_us, *place, *truth.v_l, *quat_to_euler(np.array(truth.q_lb))])
        if rows[-1][0] > seconds * 1e6:
            break
    table = np.array(rows)
    return table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10]


def test_a_mavsdk_client_follows_the_flight(
    serve: Callable[..., Any], fly_process: Callable[..., Any], tmp_path: Path
) -> None:
    port = free_port()
    script = tmp_path / "client.py"
    script.write_text(CLIENT)
    service = serve("--gcs", f"127.0.0.1:{port}", "--status", "off")
    client = subprocess.Popen(
        [sys.executable, str(script), f"udpin://127.0.0.1:{port}", str(SECONDS - 6.0)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        simulator = fly_process(service.port, SECONDS)
        said, complaint = client.communicate(timeout=SECONDS + 60.0)
        assert simulator.wait(30.0) == 0
    finally:
        if client.poll() is None:
            client.kill()
            client.communicate()
    service.stop()
    assert client.returncode == 0, said[-2000:] + complaint[-2000:]
    events = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    kinds = [event["kind"] for event in events]
    assert {"connected", "position", "attitude", "origin", "done"} <= set(kinds), complaint
    assert kinds.count("position") > 300
    assert kinds.count("attitude") > 300
    assert any(event["kind"] == "health" and event["good"] for event in events)
    what_it_read_is_where_the_vehicle_was(events)


def what_it_read_is_where_the_vehicle_was(events: list[dict[str, Any]]) -> None:
    t_us, place, velocity, euler = flown(SECONDS + 2.0)
    one = scenario.load("quad_mission")
    origin = next(event for event in events if event["kind"] == "origin")
    ecef = lla_to_ecef(math.radians(origin["lat"]), math.radians(origin["lon"]), origin["alt"])
    C_ne, base = tangent_plane(one.origin)
    offset = C_ne @ (ecef - base)
    assert np.linalg.norm(offset) < 5.0
    now_us, compared = None, 0
    moved = []
    for event in events:
        if event["kind"] == "attitude":
            now_us = event["timestamp"] = event["t_us"]
            at = int(np.searchsorted(t_us, now_us))
            errors = [
                math.degrees(wrap_pi(math.radians(angle) - true))
                for angle, true in zip(event["deg"], euler[at], strict=True)
            ]
            assert max(map(abs, errors)) < 5.0, (now_us, errors)
        elif event["kind"] == "position" and now_us is not None:
            # MAVSDK gives no stamp with it: it belongs to the attitude before it, give or take one
            at = int(np.searchsorted(t_us, now_us))
            error = np.array(event["p"]) + offset - place[at]
            assert np.linalg.norm(error) < 3.0, (now_us, error)
            assert np.linalg.norm(np.array(event["v"]) - velocity[at]) < 1.5, now_us
            moved.append(np.linalg.norm(place[at]))
            compared += 1
    assert compared > 300
    assert max(moved) > 10.0  # it has taken off while the client watched
