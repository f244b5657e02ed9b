"""Reads all that MAVSDK offers of a vehicle: `mavsdk_client.py URL TASK...`, an object of JSON per observation."""

from __future__ import annotations

import asyncio
import enum
import json
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.component_metadata import ComponentMetadataAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

STREAMS = (
    "position_velocity_ned",
    "velocity_ned",
    "position",
    "heading",
    "attitude_euler",
    "attitude_quaternion",
    "attitude_angular_velocity_body",
    "odometry",
    "imu",
    "raw_gps",
    "gps_info",
    "home",
    "health",
    "health_all_ok",
)
WATCHED_S = 6.0
RATES = {
    "attitude_quaternion": 5.0,
    "position_velocity_ned": 10.0,
    "odometry": 4.0,
    "home": 2.0,
}
RATED_S = 4.0


def plain(value: Any) -> Any:
    """A value of MAVSDK's as JSON has it."""
    if isinstance(value, enum.Enum):
        return value.name
    if hasattr(value, "__dict__"):
        return {k: plain(v) for k, v in vars(value).items() if not k.startswith("_")}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value


def say(kind: str, **values: Any) -> None:
    print(json.dumps({"kind": kind, "at": time.monotonic(), **values}), flush=True)


async def attempt(kind: str, call: Callable[..., Awaitable[Any]], *arguments: Any) -> None:
    """Call once; say how long it took and what came of it."""
    began = time.monotonic()
    try:
        value = plain(await call(*arguments))
    except Exception as error:
        result = getattr(error, "result", None)
        took = time.monotonic() - began
        say(kind, failed=getattr(result, "name", str(error)), took=took)
    else:
        say(kind, value=value, took=time.monotonic() - began)


async def read(telemetry: TelemetryAsync, name: str, kind: str) -> None:
    """Say every value of a stream."""
    stream: AsyncIterator[Any] = getattr(telemetry, f"subscribe_{name}")()
    async for value in stream:
        say(kind, stream=name, value=plain(value))


async def watch(telemetry: TelemetryAsync, names: tuple[str, ...], kind: str, s: float) -> None:
    """Read streams for some seconds."""
    readers = [asyncio.create_task(read(telemetry, name, kind)) for name in names]
    await asyncio.sleep(s)
    for reader in readers:
        reader.cancel()
    await asyncio.gather(*readers, return_exceptions=True)


async def telemetry(system: System) -> None:
    """Every stream, and the origin."""
    source = TelemetryAsync(system)
    await watch(source, STREAMS, "stream", WATCHED_S)
    await attempt("origin", source.get_gps_global_origin)


async def info(system: System) -> None:
    """Who it is."""
    source = InfoAsync(system)
    for name in ("version", "product", "identification"):
        await attempt(name, getattr(source, f"get_{name}"))


async def rates(system: System) -> None:
    """Other rates, and what comes of them; a stream that there is none of."""
    source = TelemetryAsync(system)
    for name, rate in RATES.items():
        await attempt(f"rate {name}", getattr(source, f"set_rate_{name}"), rate)
    await attempt("rate battery", source.set_rate_battery, 1.0)
    await watch(source, tuple(RATES), "rated", RATED_S)


async def parameters(system: System) -> None:
    """List all, change one of them by its half and back, ask for one that there is not."""
    source = ParamAsync(system)
    await attempt("all", source.get_all_params)
    await attempt("list again", source.get_all_params)
    name = sys.argv[3]
    before = await source.get_param_float(name)
    await attempt("set", source.set_param_float, name, 0.5 * before)
    await attempt("half", source.get_param_float, name)
    await attempt("set back", source.set_param_float, name, before)
    await attempt("whole", source.get_param_float, name)
    await attempt("refused", source.set_param_float, name, -1.0)
    await attempt("unknown", source.get_param_float, "NO_SUCH_NAME")


async def metadata(system: System) -> None:
    """Find out what the parameters are, and read the file by bursts and piece by piece."""
    source = ComponentMetadataAsync(system)
    updates = source.subscribe_metadata_available()
    first = asyncio.create_task(anext(updates))
    await source.request_autopilot_component()
    await attempt("found", asyncio.wait_for, first, 20.0)
    files = FtpAsync(system)
    for burst in (True, False):
        with tempfile.TemporaryDirectory() as folder:
            async for _ in files.download("/parameter.json", folder, burst):
                pass
            file = Path(folder) / "parameter.json"
            say("file", burst=burst, text=file.read_text("utf-8"))
            await attempt(f"same {burst}", files.are_files_identical, str(file), "/parameter.json")


TASKS = {
    "telemetry": [info, telemetry, rates],
    "parameters": [parameters],
    "metadata": [metadata],
}


async def main(url: str, task: str) -> None:
    kind = ComponentType.GROUND_STATION
    async with Mavsdk(Configuration.create_with_component_type(kind)) as mavsdk:
        await mavsdk.add_any_connection(url)
        say("listening")
        system = await mavsdk.first_autopilot(15.0)
        if system is None:
            sys.exit("no autopilot seen")
        say("connected")
        for step in TASKS[task]:
            await step(system)
        say("done")


asyncio.run(main(sys.argv[1], sys.argv[2]))
