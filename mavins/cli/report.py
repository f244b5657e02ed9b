"""`mavins report`: the report of a result folder, made again."""

from __future__ import annotations

import argparse
from pathlib import Path

SUMMARY = """\
Make the report of a result folder again: DIR/report.html, one page with findings and interactive
figures that needs no network. `mavins replay` writes it too."""

EPILOG = """\
examples:
  mavins report result
  mavins report result --png            also DIR/figures/*.png

needs the extra `report`: pip install 'mavins[report]'"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="what replay or serve wrote with --out"
    )
    parser.add_argument("--png", action="store_true", help="also write the figures as PNG files")


def run(args: argparse.Namespace) -> int:
    """Write the report and say where it is."""
    from mavins.report import write_report

    written = write_report(args.folder, args.png)
    if args.verbosity >= 0:
        print(f"written to {written[0]}")
        if len(written) > 1:
            print(f"{len(written) - 1} figures in {written[1].parent}")
    return 0
