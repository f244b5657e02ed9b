"""Replay of both recordings: seconds of flight per second of CPU, decompression and parsing included.

Beside it, how long pymavlink takes to parse a HIGHRES_IMU: how fast the machine is at such work just then.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from pymavlink.dialects.v20 import common as dialect

from mavins.config import Config
from mavins.logs.tlog import read_tlog
from mavins.replay import ReplayOptions, replay
from mavins.warmup import compile_all

SHARED = Path(os.environ.get("MAVINS_SHARED") or Path(__file__).resolve().parents[3] / "shared")
RECORDINGS = ("px4_quad_mission.tlog.xz", "ap_copter_square_circle.tlog.xz")
ROUNDS = 5
TARGET = 300.0


def parse_us() -> float:
    """CPU time in us of one HIGHRES_IMU in pymavlink."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    packet = dialect.MAVLink_highres_imu_message(1, *[0.5] * 13, 63).pack(mav)
    begin = time.process_time()
    for _ in range(2000):
        mav.parse_buffer(packet)
    return (time.process_time() - begin) / 2000 * 1e6


def run() -> None:
    """Print a line per recording; the best round counts, the others show what else the machine did."""
    compile_all(lambda line: print(line, file=sys.stderr))
    for name in RECORDINGS:
        path = SHARED / "recordings" / name
        if not path.exists():
            print(f"{name}: absent (MAVINS_SHARED names the folder above recordings/)")
            continue
        read_tlog(path)
        paces, parses = [], []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(ROUNDS):
                parses.append(parse_us())
                summary = replay(path, Path(folder), Config(), ReplayOptions())
                paces.append(summary["times_real_time"])
        parse = f"{min(parses):.0f} to {max(parses):.0f} us"
        shown = ", ".join(f"{pace:.0f}" for pace in paces)
        print(
            f"{name}: {max(paces):.0f} x real time by CPU ({summary['log_s']:.0f} s, "
            f"{summary['imu_samples']} IMU samples, {summary['rows']} rows; rounds {shown})"
            f"   target {TARGET:.0f}; pymavlink parses a HIGHRES_IMU in {parse}"
        )


if __name__ == "__main__":
    run()
