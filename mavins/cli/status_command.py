"""`mavins status`: what a running service's live status shows."""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mavins.cli.status import StatusRenderer

SUMMARY = """\
Ask the services that run on this host as this user, and show what their live status shows; it is a
second old at most."""

EPILOG = """\
examples:
  mavins status                            a panel on a terminal, else a line
  mavins status --watch                    again each second, until Ctrl-C
  mavins status --json                     one line of JSON for each service
  sudo mavins status                       of the service that systemd runs
  ssh companion mavins status              of another host"""

_PERIOD_S: Final = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--json", action="store_true", help="as JSON, which names the process too")
    parser.add_argument("--watch", action="store_true", help="repeat each second")
    parser.add_argument("--pid", type=int, metavar="PID", help="ask this one of several services")


def run(args: argparse.Namespace) -> int:
    """Find, ask, show."""
    from mavins.cli.status import make_renderer
    from mavins.errors import TransportError
    from mavins.status_socket import running

    services = running(args.pid)
    if not services:
        raise TransportError(_nobody(args.pid))
    several = len(services) > 1
    mode = "json" if args.json else "plain" if several else "auto"
    with ExitStack() as stack:
        renderers: dict[int, StatusRenderer] = {pid: make_renderer(mode) for pid in services}
        for renderer in renderers.values():
            stack.callback(renderer.close)
        while True:
            for pid, renderer in renderers.items():
                if pid not in services:
                    raise TransportError(f"the service {pid} has ended")
                if several and not args.json:
                    print(f"service {pid}")
                renderer.update(services[pid])
            if not args.watch:
                return 0
            time.sleep(_PERIOD_S)
            services = running(args.pid)


def _nobody(pid: int | None) -> str:
    """Why nothing is shown, and the way out."""
    from mavins.status_socket import hidden

    if pid is not None:
        return f"no service of this user has the process id {pid}; 'mavins status' shows all"
    if hidden():
        return "no service of this user runs here; ask the one of systemd: sudo mavins status"
    return "no service of this user runs here; start one: mavins serve --udp 14550"
