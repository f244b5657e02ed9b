"""`mavins replay`: a log through the estimator into a result folder."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from mavins.cli.choosing import LOG_HELP, add_choice, choice_of
from mavins.cli.progress import progress_bar
from mavins.errors import ConfigError

SUMMARY = """\
Run a log through the same estimator as the live service. The whole log is filtered; --start and
--end bound what is written and judged."""

EPILOG = """\
examples:
  mavins replay flight.tlog --out result
  mavins replay flight.tlog.xz --out result --start 60 --end 248
  mavins replay flight.tlog --out result --config flight.yaml --rate 0
  mavins replay flight.tlog --out result --smooth
  mavins replay flight/ --out result    a folder with imu.csv, gnss.csv, mag.csv, ... (.xz, .gz)
  mavins replay flight.ulg --out result --imu 1 --gnss sensor_gps.1

writes: OUT/<filter>/estimates.csv, innovations.csv, config.yaml and OUT/summary.json;
with --smooth also OUT/<filter>/smoothed.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "log",
        type=Path,
        metavar="LOG",
        help=LOG_HELP,
    )
    add_choice(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the result folder")
    parser.add_argument("--filter", metavar="NAME", help="the filter (default: the configured one)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    parser.add_argument("--start", type=float, metavar="S", help="boot time of the first row, s")
    parser.add_argument("--end", type=float, metavar="S", help="boot time of the last row, s")
    parser.add_argument(
        "--rate",
        type=float,
        default=50.0,
        metavar="HZ",
        help="rows per second, 0 for every IMU sample (default: 50)",
    )
    parser.add_argument(
        "--sysid", type=int, metavar="N", help="the vehicle (default: the first that sends an IMU)"
    )
    parser.add_argument(
        "--smooth",
        action="store_true",
        help="also write smoothed.csv: estimates that know what came later (Rauch-Tung-Striebel)",
    )


def run(args: argparse.Namespace) -> int:
    """Replay and print the summary."""
    from mavins.config import load
    from mavins.replay import ReplayOptions, replay

    _check_bounds(args.start, args.end, args.rate)

    overrides = {} if args.filter is None else {"filter": args.filter}
    config = load(args.config, overrides)
    options = ReplayOptions(
        args.start, args.end, args.rate, args.sysid, args.smooth, choice_of(args)
    )
    with progress_bar(f"replay {args.log.name}", 1.0, quiet=args.verbosity < 0) as report:
        summary = replay(args.log, args.out, config, options, report)
    if args.verbosity >= 0:
        print("\n".join(lines_of(summary, args.out)))
    return 0


def _check_bounds(start: float | None, end: float | None, rate: float) -> None:
    for name, value in (("--start", start), ("--end", end), ("--rate", rate)):
        if value is not None and not (0.0 <= value < math.inf):
            raise ConfigError(f"{name} {value:g} makes no sense: give a number of 0 or above")
    if start is not None and end is not None and start >= end:
        raise ConfigError(f"--start {start:g} is not before --end {end:g}")


def lines_of(summary: dict[str, Any], out: Path) -> list[str]:
    """A few lines for people: errors against the truth, aidings, pace."""
    lines = [
        f"{summary['filter']}: {summary['rows']} rows, {summary['imu_samples']} IMU samples, "
        f"{summary['log_s']:.0f} s in {summary['cpu_s']:.2f} s CPU "
        f"({summary['times_real_time']:.0f} x real time)"
    ]
    if summary["rows"] == 0:
        lines.append(f"no estimate: {summary['health']}, {summary['reason']}")
    for name, aiding in summary["aiding"].items():
        rejected = ", ".join(f"{n} {reason}" for reason, n in aiding["rejected"].items()) or "none"
        nis = aiding.get("nis_per_row")
        shown = "" if nis is None else f", NIS {nis:.3g} per row (1 where the noise is right)"
        lines.append(f"  {name}: {aiding['accepted']} fused, rejected: {rejected}{shown}")
    for key, words in (("truth", "error against"), ("reference", "difference to")):
        judged = summary.get(key, {})
        if "rms" in judged:
            lines.append(f"{words} {judged['source']}     RMS                      max")
            lines += _errors_of(judged)
    if "rms" in summary.get("smoothed", {}):
        lines.append("smoothed")
        lines += _errors_of(summary["smoothed"])
    lines.append(f"written to {out}")
    return lines


def _errors_of(judged: dict[str, Any]) -> list[str]:
    """RMS and largest errors, a line for each quantity there is."""
    units = {
        "pos_m": "position N/E/D m",
        "vel_m_s": "velocity N/E/D m/s",
        "att_deg": "roll/pitch/yaw deg",
    }
    lines = []
    for key, label in units.items():
        if key in judged["rms"]:
            rms = "/".join(f"{v:.3f}" for v in judged["rms"][key])
            largest = "/".join(f"{v:.3f}" for v in judged["max"][key])
            lines.append(f"  {label:<20} {rms:<24} {largest}")
    return lines
