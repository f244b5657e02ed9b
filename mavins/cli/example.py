"""`mavins example`: an article's system, reproduced and judged."""

from __future__ import annotations

import argparse
import importlib
import os
from pathlib import Path
from typing import Final, cast

from mavins.examples import REGISTRY
from mavins.examples.base import Example

SUMMARY = """\
Run an example: it reproduces an article's system on data and holds itself against stated figures.
The exit status is 0 only where every figure holds, 1 where one does not, 2 where data are missing."""

EPILOG = "examples:\n" + "\n".join(
    f"  mavins example {name:<17}{text}" for name, (_, text) in REGISTRY.items()
)

BESIDE: Final = Path("../shared/data")
"""Where data are looked for if neither --data nor $MAVINS_DATA says so."""
EXIT_FAILED: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("name", choices=list(REGISTRY), metavar="NAME", help=", ".join(REGISTRY))
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="the folder of data (or $MAVINS_DATA)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write pictures and tables here")


def run(args: argparse.Namespace) -> int:
    """Run the example, print its figures, name those that fail."""
    example = cast(Example, importlib.import_module(REGISTRY[args.name][0]))
    figures = example.run(data_folder(args.data), args.out, print)
    for figure in figures:
        print(figure.line())
    failed = [figure.name for figure in figures if not figure.holds]
    if failed:
        print(f"{len(failed)} of {len(figures)} figures fail: {'; '.join(failed)}")
        return EXIT_FAILED
    print(f"all {len(figures)} figures hold")
    return 0


def data_folder(named: Path | None) -> Path | None:
    """The folder of data: as named, from the environment, or beside the working directory if it is there."""
    if named is not None:
        return named
    if configured := os.environ.get("MAVINS_DATA"):
        return Path(configured).expanduser()
    return BESIDE if BESIDE.is_dir() else None
