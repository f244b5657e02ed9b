"""What the commands that read logs have in common: which log, and which of its sources."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mavins.logs.sensor_log import Choice

LOG_HELP: Final = (
    "a .tlog, .ulg, .BIN or dataflash .log, a folder of CSV files, an EuRoC folder or KF-GINS text; "
    "packed in .gz, .xz or .zst, too"
)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Declare --imu, --gnss and --reference."""
    group = parser.add_argument_group("sources, by name or number as `mavins info LOG` lists them")
    group.add_argument("--imu", metavar="NAME", help="the IMU that is used")
    group.add_argument("--gnss", metavar="NAME", help="the GNSS receiver that is used")
    group.add_argument("--reference", metavar="NAME", help="whose estimate is compared with")


def choice_of(args: argparse.Namespace) -> Choice:
    """The sources that were asked for."""
    from mavins.logs.sensor_log import Choice

    return Choice(args.imu, args.gnss, args.reference)
