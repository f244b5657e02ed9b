"""`--signing-key-file` of the commands that sign what they send and verify what they receive."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavins.signing_store import Signing


def add_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the option."""
    parser.add_argument(
        "--signing-key-file",
        type=Path,
        metavar="FILE",
        help="sign what is sent and verify what comes (MAVLink 2) with this key: 32 bytes or 64 hexadecimal digits, "
        "readable by you alone",
    )


def signing_of(args: argparse.Namespace) -> Signing | None:
    """The signing that was asked for; KeyFileError where the key cannot be used."""
    if args.signing_key_file is None:
        return None
    from mavins.signing_store import Signing

    return Signing(args.signing_key_file)
