"""`--record` and `--record-max-size` of the commands that write telemetry logs."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mavins.logs.recording import Recording

SMALLEST: Final = 1 << 20
_UNITS: Final = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--record", type=Path, metavar="FILE.tlog", help="record every packet in and out"
    )
    parser.add_argument(
        "--record-max-size",
        type=size,
        metavar="SIZE",
        help="go on in FILE.1.tlog, FILE.2.tlog ... after SIZE bytes (500M, 2G); nothing is written over",
    )


def size(text: str) -> int:
    """`500M` -> bytes; K, M and G are powers of 1024."""
    found = re.fullmatch(r"([0-9]{1,15})([KMG]?)", text.upper())
    number = int(found[1]) * _UNITS[found[2]] if found else 0
    if number < SMALLEST:
        raise argparse.ArgumentTypeError(f"'{text}' is not a size of at least 1M, such as 500M")
    return number


def recording_of(args: argparse.Namespace, warn: Callable[[str], None]) -> Recording | None:
    """The recording that was asked for; OutputError where it cannot be begun."""
    if args.record is None:
        return None
    from mavins.logs.recording import Recording

    return Recording(args.record, args.record_max_size, warn)
