"""`mavins serve`: the live service on UDP, TCP, serial lines and multicast."""

from __future__ import annotations

import argparse
import contextlib
import gc
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mavins.cli import record, signing
from mavins.transports.base import Admits, everyone

if TYPE_CHECKING:
    from mavins.service import Address
    from mavins.status_socket import StatusSocket
    from mavins.transports.base import Link, Say
    from mavins.transports.urls import LinkUrl

SUMMARY = """\
Listen to a vehicle's sensor messages, estimate its position, velocity and attitude, and send them
back to everyone who talks to us. Ends cleanly on Ctrl-C."""

EPILOG = """\
examples:
  mavins serve --udp 14550
  mavins serve --udp 14540 --gcs 127.0.0.1:14550      a ground station here holds 14550 itself
  mavins serve --udp 14550 --record flight.tlog --out result
  mavins serve --udp 127.0.0.1:14551 --status json
  mavins serve --link 'serial:///dev/ttyAMA0?baud=921600' --gcs 192.168.1.20:14550 --route

links:
  udp://:14550                          as --udp 14550; udp://[::]:14550 is IPv4 and IPv6
  udpout://192.168.1.20:14550           to one address, from a port of its own
  tcp://127.0.0.1:5760                  to a server, again whenever the connection is lost
  tcpin://:5760                         a server for many clients
  serial:///dev/ttyAMA0?baud=921600     57600 baud where none is named; needs mavins[serial];
                                        &trusted=1: it may change the state as this host may
  udpmcast://239.255.145.50:14550       a multicast group; ?interface=IP chooses the interface"""

STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--udp",
        action="append",
        default=[],
        metavar="[HOST:]PORT",
        help="listen here; a PORT alone binds all interfaces (repeatable)",
    )
    parser.add_argument(
        "--gcs",
        action="append",
        default=[],
        metavar="HOST:PORT",
        help="a ground station that receives without having sent, from the first UDP port we listen "
        "on (repeatable)",
    )
    parser.add_argument(
        "--link",
        action="append",
        default=[],
        metavar="URL",
        help="another link, of any kind below (repeatable)",
    )
    parser.add_argument("--filter", metavar="NAME", help="the filter (default: the configured one)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    parser.add_argument(
        "--persona",
        choices=("vehicle", "companion"),
        help="a vehicle of our own, or a component of the one we listen to (default: vehicle)",
    )
    parser.add_argument(
        "--route",
        action="store_true",
        help="forward packets between peers: one link then serves a ground station and us",
    )
    parser.add_argument(
        "--allow-remote-config",
        action="store_true",
        help="take parameters, origins and resets from other hosts too",
    )
    record.add_arguments(parser)
    signing.add_argument(parser)
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
    from mavins.errors import TransportError
    from mavins.transports.base import parse_address
    from mavins.transports.urls import LinkUrl, parse_url

    urls = [LinkUrl("udp", *parse_address(text)) for text in args.udp]
    urls += [parse_url(text) for text in args.link]
    if not urls:
        raise TransportError("nothing to listen to: give --udp 14550, or --link URL")
    gcs = [parse_address(text, "127.0.0.1") for text in args.gcs]
    config = load(args.config, _overrides(args))

    from mavins.cli.status import make_renderer
    from mavins.mavlink.limits import AllowList, networks
    from mavins.service import Service, check_outputs
    from mavins.transports.sockets import resolve
    from mavins.warmup import compile_all

    # what cannot work is said before the kernels are compiled, which may take half a minute
    check_outputs(config, args.out, args.record)
    urls, stations = _with_stations(urls, [resolve(*address) for address in gcs])
    quiet = args.verbosity < 0

    def say(line: str) -> None:
        if not quiet:
            print(line, file=sys.stderr, flush=True)

    _close(_open(urls, say))
    compile_all(say, config.filter)
    links: list[Link] = []
    asked: list[int] = []
    renderer = make_renderer("off" if quiet and args.status == "auto" else args.status)
    before = {n: signal.signal(n, lambda n, _: asked.append(n)) for n in STOP_SIGNALS}
    try:
        links = _open(urls, say, AllowList(networks(config.limits.allow)).__contains__)
        service = Service(
            config,
            links,
            stations,
            args.out,
            record.recording_of(args, say),
            renderer.update,
            signing.signing_of(args),
            args.config,
            _status_socket(say),
            [url.unsigned for url in urls],
        )
        for link in links:
            print(link.announcement, flush=True)
        # what is here by now stays: the collector need not look at it again while samples wait
        gc.collect()
        gc.freeze()
        service.run(lambda: bool(asked))
    finally:
        renderer.close()
        _close(links)
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _status_socket(say: Say) -> StatusSocket | None:
    """Where `mavins status` asks; a service serves without, too."""
    from mavins.errors import TransportError
    from mavins.status_socket import StatusSocket

    try:
        return StatusSocket()
    except TransportError as error:
        say(f"mavins status will not find this service: {error}")
        return None


def _overrides(args: argparse.Namespace) -> dict[str, Any]:
    """What the command line says over the configuration file."""
    given = {
        "filter": args.filter,
        "mavlink.persona": args.persona,
        "mavlink.route": args.route or None,
        "mavlink.allow_remote_config": args.allow_remote_config or None,
    }
    return {key: value for key, value in given.items() if value is not None}


def _with_stations(
    urls: list[LinkUrl], gcs: Sequence[tuple[str, int]]
) -> tuple[list[LinkUrl], list[Address]]:
    """The links, and which of them sends to which ground station.

    A station that is sent to from the first UDP port we listen on can answer there. Where there is none of
    its family, it has a link of its own.
    """
    from mavins.transports.sockets import family_of, resolve
    from mavins.transports.urls import LinkUrl

    stations: list[Address] = []
    alone: list[LinkUrl] = []
    for host, port in gcs:
        for index, url in enumerate(urls):
            ours = resolve(url.host)[0] if url.host else ""
            if url.kind == "udp" and family_of(ours) == family_of(host):
                stations.append((index, host, port))
                break
        else:
            alone.append(LinkUrl("udpout", host, port))
    return urls + alone, stations


def _open(urls: Sequence[LinkUrl], say: Say, admits: Admits = everyone) -> list[Link]:
    """Open all links, or none."""
    from mavins.transports.links import open_link

    links: list[Link] = []
    with contextlib.ExitStack() as opened:
        for url in urls:
            links.append(open_link(url, say, admits))
            opened.callback(links[-1].close)
        opened.pop_all()
    return links


def _close(links: Sequence[Link]) -> None:
    for link in links:
        link.close()
