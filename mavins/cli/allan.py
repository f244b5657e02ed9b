"""`mavins allan`: an IMU's noises from a log in which it stands still."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavins.evaluation.allan import Allan, Axis, Coefficient

SUMMARY = """\
White noise, bias instability and random walk of gyro and accelerometer from a log in which the IMU
stands still (overlapping Allan deviation), and the settings that follow from them."""

EPILOG = """\
examples:
  mavins allan standing.tlog
  mavins allan standing.BIN --out allan.yaml --png allan.png
  mavins serve --config allan.yaml

The longest spell of standing is used. An hour shows white noise and bias instability, a few hours the
random walk. Motors that run, or a vehicle in flight, are noisier than what this shows: see mavins tune."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", type=Path, metavar="LOG", help="a log of any kind")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the settings here, YAML")
    parser.add_argument("--png", type=Path, metavar="FILE", help="draw the deviations")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    parser.add_argument(
        "--sysid", type=int, metavar="N", help="the vehicle of a log (default: the first)"
    )


def run(args: argparse.Namespace) -> int:
    """Analyse, print the table and the block of settings, write what is asked for."""
    from mavins import __version__, yaml_text
    from mavins.config import load, merged
    from mavins.evaluation.allan import allan
    from mavins.results import write_text
    from mavins.sources import imu_of

    result = allan(imu_of(args.log, load(args.config), args.sysid))
    if args.png is not None:
        from mavins.evaluation.allan_plot import draw_allan

        draw_allan(args.png, result)
    lines = yaml_text.block(merged({}, result.settings()), {})
    text = "\n".join([f"# mavins {__version__} allan", *lines]) + "\n"
    if args.verbosity >= 0:
        print("\n".join(lines_of(result)))
    if args.out is None:
        print(text, end="")
    else:
        write_text(args.out, text)
        print(f"written to {args.out}")
    return 0


def lines_of(result: Allan) -> list[str]:
    """The spell, the table, and what is missing."""
    from mavins.evaluation.allan import UNITS

    lines = [
        f"standing for {result.seconds:.0f} s from {result.start_s:.0f} s on, "
        f"{1.0 / result.dt:.1f} samples a second"
    ]
    if result.seconds < 0.95 * result.log_s:
        lines.append(f"warning: the log is {result.log_s:.0f} s long, and not standing throughout")
    lines.append(f"{'':<9}{'white noise':<36}{'bias instability':<36}random walk")
    for sensor, units in UNITS.items():
        lines.append(f"{'':<9}" + "".join(f"{unit:<36}" for unit in units).rstrip())
        lines += [_line(axis) for axis in result.of(sensor)]
    missing = [axis.name for axis in result.axes if not axis.walk.seen]
    if missing:
        lines.append(
            f"warning: too short for a random walk ({', '.join(missing)}): no more than its upper bound shows"
        )
    unclear = [axis.name for axis in result.axes if not axis.white.seen]
    if unclear:
        lines.append(f"warning: no white noise is seen ({', '.join(unclear)}): is the IMU at rest?")
    return lines


def _line(axis: Axis) -> str:
    parts = (axis.white, axis.instability, axis.walk)
    return f"{axis.name:<9}" + "".join(f"{_words(part):<36}" for part in parts).rstrip()


def _words(c: Coefficient) -> str:
    if not c.seen:
        return f"below {c.high:.3g}"
    return f"{c.value:.3g} ({c.low:.3g} .. {c.high:.3g})"
