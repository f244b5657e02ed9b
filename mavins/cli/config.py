"""`mavins config`: every setting as commented YAML, or a file checked and completed."""

from __future__ import annotations

import argparse
from pathlib import Path

SUMMARY = """\
Print the configuration as commented YAML: each key with its meaning, unit, default and range.
With --config, the file is checked and the effective configuration printed."""

EPILOG = """\
examples:
  mavins config --default > mavins.yaml      a file to start from
  mavins config --config mavins.yaml         is it right, and what does it come to?
  mavins config --plain                      the bare keys and values"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--default", action="store_true", help="the defaults (as without options)")
    which.add_argument("--config", type=Path, metavar="FILE", help="check and complete this file")
    parser.add_argument("--plain", action="store_true", help="without comments")


def run(args: argparse.Namespace) -> int:
    """Print the effective configuration."""
    from mavins.config import load, to_yaml

    print(to_yaml(load(args.config), commented=not args.plain), end="")
    return 0
