"""`mavins replay`: a log through the estimator into a result folder."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavins.cli.campaign_options import add_worker_options, workers_of
from mavins.cli.choosing import LOG_HELP, add_choice, choice_of
from mavins.cli.progress import progress_bar
from mavins.errors import ConfigError

if TYPE_CHECKING:
    from mavins.config import Config
    from mavins.estimates import Result
    from mavins.replay import ReplayOptions

SUMMARY = """\
Run a log, or every log of a folder, through the same estimator as the live service. A whole log is
filtered; --start and --end bound what is written and judged."""

EPILOG = """\
examples:
  mavins replay flight.tlog --out result
  mavins replay flight.tlog.xz --out result --start 60 --end 248
  mavins replay flight.tlog --out result --config flight.yaml --rate 0
  mavins replay flight.tlog --out result --smooth
  mavins replay flight/ --out result    a folder with imu.csv, gnss.csv, mag.csv, ... (.xz, .gz)
  mavins replay flight.ulg --out result --imu 1 --gnss sensor_gps.1
  mavins replay flight.tlog --out result --export mcap,tlog
  mavins replay flight.tlog --dry-run   what would be used
  mavins replay archive/ --out results --jobs 4          every log of a folder and those below it

writes: OUT/<filter>/estimates.csv, innovations.csv, config.yaml, evidence.npz, OUT/summary.json
and OUT/report.html; with --smooth also OUT/<filter>/smoothed.csv; other formats beside them (--export).
All of it takes the place of an earlier result at once, at the end; other files in OUT stay.
of a folder of logs: all this but the report in OUT/<log>/, and archive.csv and archive.json over all; what is
finished is not done again, and where a log could not be replayed the exit status is 1"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "log",
        type=Path,
        metavar="LOG",
        help=f"{LOG_HELP}, or a folder of logs",
    )
    add_choice(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="the result folder")
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
    parser.add_argument(
        "--export",
        default="usual",
        metavar="FORMATS",
        help="comma-separated: tum, kml, gpx, parquet, mcap, tlog; all; none (default: the first "
        "three, and parquet with the extra 'export')",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="read the log, say what would be used and written, and run nothing",
    )
    parser.add_argument(
        "--no-report", action="store_true", help="write no report.html (mavins report makes it)"
    )
    add_worker_options(parser, "of a folder of logs: ")


def run(args: argparse.Namespace) -> int:
    """Replay and print the summary."""
    from mavins.campaign.archive import is_archive
    from mavins.config import load
    from mavins.exports import REGISTRY, TLOG, formats_of
    from mavins.replay import ReplayOptions, replay

    _check_bounds(args.start, args.end, args.rate)
    if args.out is None and not args.dry_run:
        raise ConfigError("where to? give a result folder: --out DIR")
    formats = formats_of(args.export, (*REGISTRY, TLOG))

    overrides = {} if args.filter is None else {"filter": args.filter}
    config = load(args.config, overrides)
    options = ReplayOptions(
        args.start,
        args.end,
        args.rate,
        args.sysid,
        args.smooth,
        choice_of(args),
        formats,
    )
    if is_archive(args.log):
        return _archive(args, config, options)
    if args.jobs is not None or args.scheduler is not None:
        raise ConfigError(f"--jobs and --scheduler are for a folder of logs, {args.log} is one log")
    if args.dry_run:
        from mavins.cli.dry_run import lines_of as plan_of

        print("\n".join(plan_of(args.log, args.out, config, options)))
        return 0
    with progress_bar(f"replay {args.log.name}", 1.0, quiet=args.verbosity < 0) as report:
        finish = None if args.no_report else partial(_report, args.out)
        summary = replay(args.log, args.out, config, options, report, finish)
    if args.verbosity >= 0:
        print("\n".join(lines_of(summary, args.out)))
    return 0


def _report(out: Path, result: Result, aside: Path) -> None:
    """Write the report into `aside`, which is to take the place of `out`.

    Without the extra, say how to get it: the results are whole without it.
    """
    try:
        from mavins.report import write_report_of

        write_report_of(result, aside)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "plotly":
            raise
        print(
            "mavins: no report.html: plotly is not installed; install it with: "
            "pip install 'mavins[report]', then: mavins report " + shlex.quote(str(out)),
            file=sys.stderr,
        )


def _archive(args: argparse.Namespace, config: Config, options: ReplayOptions) -> int:
    """Replay all logs of a folder, print the table over all; 1 where one could not be replayed."""
    from mavins.campaign.archive import (
        DONE,
        FAILED,
        finished,
        jobs_of,
        replay_archive,
        table_lines,
        write_archive,
    )
    from mavins.results import check_folder

    workers, quiet = workers_of(args), args.verbosity < 0
    jobs = jobs_of(args.log, args.out, config, options)
    check_folder(args.out)
    before = sum(finished(job) is not None for job in jobs)
    with progress_bar(f"replay {args.log.name}", 1.0, quiet=quiet) as report:
        replayed = replay_archive(jobs, workers, report)
    write_archive(args.out, args.log, replayed)
    if not quiet:
        print("\n".join(table_lines(replayed)))
        done = sum(one.status == DONE for one in replayed)
        print(f"{done} of {len(jobs)} replayed ({before} of them before), written to {args.out}")
    return int(any(one.status == FAILED for one in replayed))


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
