"""`mavins export`: a result folder in other formats."""

from __future__ import annotations

import argparse
from pathlib import Path

from mavins.errors import ConfigError

SUMMARY = """\
Write what a result folder holds in formats that other tools open, beside its own files."""

EPILOG = """\
examples:
  mavins export result --to mcap
  mavins export result --to tum,kml,gpx
  mavins export result --to all --filter iekf

writes: DIR/<filter>/estimates.tum, track.kml, track.gpx, estimates.parquet, innovations.parquet, flight.mcap.
Messages (output.tlog) are made while a log runs: mavins replay LOG --out DIR --export tlog"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="a result folder")
    parser.add_argument(
        "--to",
        required=True,
        metavar="FORMATS",
        help="comma-separated: tum, kml, gpx, parquet, mcap; or all",
    )
    parser.add_argument(
        "--filter", metavar="NAME", help="whose result (default: the one that summary.json names)"
    )


def run(args: argparse.Namespace) -> int:
    """Read the result, write the files."""
    from mavins.evaluation.result_folder import read_result
    from mavins.exports import REGISTRY, TLOG, formats_of, write_exports
    from mavins.whole_folder import written_whole

    if TLOG in args.to.split(","):
        raise ConfigError(
            "a result folder does not tell all that is in our messages: "
            "mavins replay LOG --out DIR --export tlog"
        )
    formats = formats_of(args.to, tuple(REGISTRY))
    result = read_result(args.folder, args.filter)
    folder = args.folder / result.filter
    with written_whole(folder) as aside:
        write_exports(result, formats, aside)
    if args.verbosity >= 0:
        for name in formats:
            for file in REGISTRY[name].FILES:
                print(folder / file)
    return 0
