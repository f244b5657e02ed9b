"""`mavins warmup`: compile every kernel once, so that the next start finds them in the cache."""

from __future__ import annotations

import argparse
import sys
import time

from mavins.filters import REGISTRY

SUMMARY = "Compile every kernel that a filter uses and keep the result, so that later starts take a second or two."

ALL = "all"

EPILOG = """\
examples:
  mavins warmup --filter all                 for every filter, some minutes
  mavins warmup                              into $MAVINS_CACHE or the user's cache folder
  MAVINS_CACHE=/var/cache/mavins mavins warmup"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--filter",
        choices=[*REGISTRY, ALL],
        default=next(iter(REGISTRY)),
        metavar="NAME",
        help=f"for this filter (default: %(default)s): {', '.join(REGISTRY)}, or {ALL}",
    )


def run(args: argparse.Namespace) -> int:
    """Compile, with a line for each step on stderr."""
    from mavins.warmup import compile_all

    def report(step: str) -> None:
        if args.verbosity >= 0:
            print(step, file=sys.stderr, flush=True)

    start = time.monotonic()
    for name in REGISTRY if args.filter == ALL else [args.filter]:
        compile_all(report, name)
    report(f"ready after {time.monotonic() - start:.1f} s")
    return 0
