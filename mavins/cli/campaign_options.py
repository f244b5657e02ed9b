"""The options of all commands that spread jobs over workers."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavins.campaign.workers import Workers


def add_worker_options(parser: argparse.ArgumentParser, when: str = "") -> None:
    """Declare --jobs and --scheduler."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=int, metavar="N", help=f"{when}worker processes (default: one for each core)"
    )
    where.add_argument(
        "--scheduler",
        metavar="URL",
        help=f"{when}a Dask scheduler's address, tcp://HOST:8786 (needs the extra 'dask')",
    )


def workers_of(args: argparse.Namespace) -> Workers:
    """The workers that were asked for."""
    from mavins.campaign.workers import Workers

    return Workers(args.jobs, args.scheduler)
