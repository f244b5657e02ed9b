"""The first position through MAVSDK's server, as programs of MAVSDK 1 to 3 read it: `grpc_client.py URL PORT`."""

from __future__ import annotations

import asyncio
import json
import sys

from mavsdk_grpc import System


async def main(url: str, port: int) -> None:
    drone = System(port=port)
    await drone.connect(system_address=url)
    async for state in drone.core.connection_state():
        if state.is_connected:
            break
    async for at in drone.telemetry.position():
        place = [at.latitude_deg, at.longitude_deg, at.absolute_altitude_m, at.relative_altitude_m]
        print(json.dumps({"kind": "position", "place": place}), flush=True)
        break
    async for both in drone.telemetry.position_velocity_ned():
        p = both.position
        print(json.dumps({"kind": "ned", "p": [p.north_m, p.east_m, p.down_m]}), flush=True)
        break


asyncio.run(asyncio.wait_for(main(sys.argv[1], int(sys.argv[2])), 40.0))
