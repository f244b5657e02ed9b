"""`mavins play`: a recorded flight into a UDP port, at its own pace."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mavins.cli.progress import progress_bar

if TYPE_CHECKING:
    from mavins.mavlink.codec import Frames
    from mavins.transports.udp import UdpTransport

SUMMARY = """\
Send one vehicle's packets of a log into a UDP port, each when it was received then, as the vehicle
itself would have: a recorded flight against a live service. What comes back is read and dropped."""

EPILOG = """\
examples:
  mavins play flight.tlog --udp 127.0.0.1:14550
  mavins play flight.tlog.xz --udp 127.0.0.1:14550 --speed 4
  mavins play flight.tlog --udp 127.0.0.1:14550 --sysid 8 --speed max

With --speed max a receiver slower than this loses packets."""

REPORT_EVERY: Final = 64
"""Packets between two looks at the progress bar and, at full speed, at what came back."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", type=Path, metavar="LOG", help="a .tlog, also in .gz or .xz")
    parser.add_argument("--udp", required=True, metavar="HOST:PORT", help="send the packets there")
    parser.add_argument(
        "--speed",
        type=_speed,
        default=1.0,
        metavar="X",
        help="times the recorded pace, or 'max' (default: 1)",
    )
    parser.add_argument(
        "--sysid",
        type=int,
        metavar="N",
        help="the system to play, all its components (default: the first that sends an IMU)",
    )


def run(args: argparse.Namespace) -> int:
    """Send the packets; Ctrl-C ends it early."""
    from mavins.logs.inspect import choose_system
    from mavins.logs.tlog import read_tlog
    from mavins.transports.base import parse_address
    from mavins.transports.udp import UdpTransport

    host, port = parse_address(args.udp, "127.0.0.1")
    frames = read_tlog(args.log)
    sysid = choose_system(frames, args.sysid)
    mine = frames.select(frames.sysid == sysid)
    transport = UdpTransport.client(host, port)
    quiet = args.verbosity < 0
    start = time.monotonic()
    sent = 0
    try:
        with progress_bar(f"system {sysid}", len(mine), quiet) as report:
            for sent in _play(mine, transport, args.speed):
                if sent % REPORT_EVERY == 0:
                    report(sent)
    finally:
        transport.close()
        if not quiet:
            print(
                f"sent {sent} of {len(mine)} packets of system {sysid} to {host}:{port} "
                f"in {time.monotonic() - start:.1f} s",
                file=sys.stderr,
            )
            if refused := transport.send_errors + transport.receive_errors:
                print(f"{refused} times nobody listened there", file=sys.stderr)
    return 0


def _play(
    frames: Frames,
    transport: UdpTransport,
    speed: float,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[int]:
    """Send each packet when it is due; yields how many have gone out."""
    due = due_times(frames, speed)
    start = clock()
    for i in range(len(frames)):
        while (wait := due[i] - (clock() - start)) > 0.0:
            transport.recv(wait)
        if i % REPORT_EVERY == 0:
            transport.recv(0.0)
        transport.send(frames.packet(i))
        yield i + 1


def due_times(frames: Frames, speed: float) -> list[float]:
    """Seconds after the first packet at which each is due; a recorder's clock that stepped back
    waits.
    """
    import numpy as np

    elapsed = np.maximum.accumulate(frames.t_us) - frames.t_us[:1]
    due: list[float] = (elapsed * (0.0 if math.isinf(speed) else 1e-6 / speed)).tolist()
    return due


def _speed(text: str) -> float:
    if text == "max":
        return math.inf
    try:
        speed = float(text)
    except ValueError:
        speed = math.nan
    if not (speed > 0.0 and math.isfinite(speed)):
        raise argparse.ArgumentTypeError("give a number above 0, or 'max'")
    return speed
