"""The simulator's command line, both as `mavins sitl` and as `python -m sitl`."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import math
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Final

from mavins.errors import MavinsError, ScenarioError

SUMMARY: Final = """\
Fly the simulator: a vehicle's sensors and its true state as MAVLink, to a UDP port, a log, or both.
A seed gives the same packets each time, whatever the speed."""

EPILOG: Final = """\
scenarios: quad_mission, square_spiral, hover, figure8, gnss_outage, or a YAML file of your own

examples:
  mavins sitl --udp 127.0.0.1:14550                          a quadrotor's mission in real time
  mavins sitl --udp 127.0.0.1:14550 --scenario gnss_outage --speed 4
  mavins sitl --record flight.tlog --duration 300 --speed max
  mavins sitl --record flight.tlog --scenario mine.yaml --duration 60 --seed 7 --speed max

With --speed max over UDP a receiver slower than the simulator loses packets; a log does not."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--udp", metavar="HOST:PORT", help="send the packets there")
    parser.add_argument("--record", metavar="FILE.tlog", type=Path, help="write the packets there")
    parser.add_argument(
        "--scenario",
        default="quad_mission",
        metavar="NAME|FILE.yaml",
        help="what to fly (default: %(default)s)",
    )
    parser.add_argument(
        "--duration",
        type=_positive,
        default=math.inf,
        metavar="S",
        help="seconds of simulated time (default: endless)",
    )
    parser.add_argument(
        "--speed",
        type=_speed,
        default=1.0,
        metavar="X",
        help="times real time, or 'max' (default: 1)",
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="default: 0")
    parser.add_argument("--sysid", type=_identity, default=1, metavar="N", help="default: 1")
    parser.add_argument("--compid", type=_identity, default=1, metavar="N", help="default: 1")


def run(args: argparse.Namespace) -> int:
    """Fly until the duration is over or a signal ends it."""
    if args.udp is None and args.record is None:
        raise ScenarioError("nowhere to send the packets: give --udp HOST:PORT, --record FILE.tlog")
    from mavins.logs.tlog import TlogWriter
    from mavins.mavlink.codec import Payload
    from mavins.transports.base import parse_address
    from mavins.transports.udp import UdpTransport
    from sitl import scenario
    from sitl.emitter import UNIX_AT_BOOT_US, Emitter, fly
    from sitl.simulation import Simulation

    with contextlib.ExitStack() as stack:
        stop = stack.enter_context(_stop_signals())
        simulation = Simulation(scenario.load(args.scenario), args.seed)
        emitter = Emitter(simulation.scenario, args.sysid, args.compid)
        stream = (item for block in simulation.blocks() for item in emitter.payloads(block))
        udp = log = None
        if args.udp is not None:
            udp = UdpTransport.client(*parse_address(args.udp, "127.0.0.1"))
            stack.callback(udp.close)
        if args.record is not None:
            log = stack.enter_context(TlogWriter(args.record))

        now = (0, 0.0)

        def output(t_us: int, payload: Payload) -> None:
            nonlocal now
            now = t_us, time.monotonic()
            send(t_us, emitter.number(payload))
            listen(0.0)

        def send(t_us: int, packet: bytes) -> None:
            if log is not None:
                log.write(UNIX_AT_BOOT_US + t_us, packet)
            if udp is not None:
                udp.send(packet)

        def listen(seconds: float) -> None:
            for data, _ in udp.recv(seconds) if udp is not None else ():
                t_us, since = now
                if args.speed < math.inf:
                    t_us += round((time.monotonic() - since) * args.speed * 1e6)
                for answer in emitter.answer(data, t_us):
                    send(now[0], answer)  # a log's stamps never step back

        # the first second is made, and all kernels compiled, before the clock starts
        whole = itertools.chain([next(stream)], stream)
        if args.verbosity >= 0:
            targets = ", ".join(str(target) for target in (args.udp, args.record) if target)
            print(f"flying {args.scenario}, seed {args.seed}, to {targets}", file=sys.stderr)
        wait = time.sleep if udp is None else listen
        fly(whole, output, args.duration, args.speed, lambda: bool(stop), udp is not None, wait)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """`python -m sitl`: the exit status is 2, with one line, for a user's error."""
    parser = argparse.ArgumentParser(
        prog="python -m sitl",
        description=SUMMARY,
        epilog=EPILOG.replace("mavins sitl", "python -m sitl"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_arguments(parser)
    parser.set_defaults(verbosity=0)
    try:
        return run(parser.parse_args(argv))
    except MavinsError as error:
        print(f"sitl: {' '.join(str(error).split())}", file=sys.stderr)
        return 2


@contextlib.contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """A list that is no longer empty once SIGINT or SIGTERM has come."""
    seen: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        seen.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield seen
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError("must be above 0")
    return value


def _speed(text: str) -> float:
    return math.inf if text == "max" else _positive(text)


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must be 0 or above")
    return value


def _identity(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 255:
        raise argparse.ArgumentTypeError("must be 1 to 255")
    return value
