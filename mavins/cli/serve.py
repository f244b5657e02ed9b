"""`mavins serve`: the live service on UDP."""

from __future__ import annotations

import argparse
import gc
import signal
import sys
from pathlib import Path
from typing import Final

SUMMARY = """\
Listen to a vehicle's sensor messages, estimate its position, velocity and attitude, and send them
back to everyone who talks to us. Ends cleanly on Ctrl-C."""

EPILOG = """\
examples:
  mavins serve --udp 14550
  mavins serve --udp 14540 --gcs 127.0.0.1:14550      a ground station here holds 14550 itself
  mavins serve --udp 14550 --record flight.tlog --out result
  mavins serve --udp 127.0.0.1:14551 --status json"""

STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--udp",
        action="append",
        required=True,
        metavar="[HOST:]PORT",
        help="listen here; a PORT alone binds all interfaces (repeatable)",
    )
    parser.add_argument(
        "--gcs",
        action="append",
        default=[],
        metavar="HOST:PORT",
        help="a ground station that receives without having sent (repeatable)",
    )
    parser.add_argument("--filter", metavar="NAME", help="the filter (default: the configured one)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    parser.add_argument(
        "--record", type=Path, metavar="FILE.tlog", help="record every packet in and out"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write estimates.csv and summary.json as replay does",
    )
    parser.add_argument(
        "--status",
        choices=("auto", "plain", "json", "off"),
        default="auto",
        help="the live status (default: a panel on a terminal, else a line per second)",
    )


def run(args: argparse.Namespace) -> int:
    """Compile, bind, serve."""
    from mavins.config import load
    from mavins.transports.base import parse_address

    addresses = [parse_address(text) for text in args.udp]
    gcs = [parse_address(text, "127.0.0.1") for text in args.gcs]
    config = load(args.config, {} if args.filter is None else {"filter": args.filter})

    from mavins.cli.status import make_renderer
    from mavins.service import Service, check_outputs
    from mavins.transports.udp import UdpTransport, resolve
    from mavins.warmup import compile_all

    # what cannot work is said before the kernels are compiled, which may take half a minute
    check_outputs(config, args.out, args.record)
    gcs = [resolve(*address) for address in gcs]
    for host, port in addresses:
        UdpTransport.bind(host, port).close()
    quiet = args.verbosity < 0
    compile_all(
        lambda line: None if quiet else print(line, file=sys.stderr, flush=True), config.filter
    )
    links: list[UdpTransport] = []
    asked: list[int] = []
    renderer = make_renderer("off" if quiet and args.status == "auto" else args.status)
    before = {n: signal.signal(n, lambda n, _: asked.append(n)) for n in STOP_SIGNALS}
    try:
        for host, port in addresses:
            links.append(UdpTransport.bind(host, port))
        service = Service(config, links, gcs, args.out, args.record, renderer.update)
        for link in links:
            host, port = link.address
            print(f"listening udp {host}:{port}", flush=True)
        # what is here by now stays: the collector need not look at it again while samples wait
        gc.collect()
        gc.freeze()
        service.run(lambda: bool(asked))
    finally:
        renderer.close()
        for link in links:
            link.close()
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0
