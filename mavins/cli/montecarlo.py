"""`mavins montecarlo`: a scenario flown many times, and what the errors of all runs say."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from mavins.cli.campaign_options import add_worker_options, workers_of
from mavins.errors import ConfigError

if TYPE_CHECKING:
    from mavins.campaign.montecarlo import Flown

SUMMARY = """\
Fly a scenario many times, each time with other errors, through one filter or several, and say what
the runs have in common: error percentiles, consistency (NEES and NIS with their 95 % bands), time
to converge. A run depends on its seed alone, not on how many workers there are."""

EPILOG = """\
examples:
  mavins montecarlo quad_mission --runs 100 --out result
  mavins montecarlo quad_mission --runs 200 --filters eskf,iekf --vary spread.yaml --out result
  mavins montecarlo my_scenario.yaml --runs 1000 --scheduler tcp://10.0.0.1:8786 --out result

spread.yaml: what is drawn for each run, by its place in the scenario or in the configuration:
  scenario.imu.gyro.noise: {loguniform: [1.0e-4, 1.0e-3]}
  scenario.gnss.latency: {uniform: [0.0, 0.2]}
  scenario.motion.segments.2.speed: {normal: [8, 1]}
  config.heading.sigma_deg: {choice: [1, 2, 5]}

The filters are told the noises, lever arm and latency of the scenario as its file has them, unless
--config is given.
writes: OUT/montecarlo.json, runs.csv, timing.csv and, with the extra 'report', montecarlo.png"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("scenario", metavar="SCENARIO", help="a scenario's name or .yaml file")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the result folder")
    parser.add_argument(
        "--runs", type=int, default=100, metavar="N", help="simulated flights (default: 100)"
    )
    parser.add_argument(
        "--filters",
        metavar="NAMES",
        help="comma-separated, or all (default: the configured one)",
    )
    parser.add_argument(
        "--vary", type=Path, metavar="FILE", help="parameters that differ between runs, in YAML"
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=300.0,
        metavar="S",
        help="seconds of each flight (default: 300)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the first run (default: 0)"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    add_worker_options(parser)


def run(args: argparse.Namespace) -> int:
    """Fly the series, print the table, write the files."""
    from mavins.campaign.montecarlo import Series, montecarlo
    from mavins.campaign.series_files import (
        FILES,
        by_filter,
        pace_line,
        table_lines,
        write_series,
    )
    from mavins.campaign.vary import read_spreads
    from mavins.campaign.workers import ready
    from mavins.cli.compare import filters_of
    from mavins.cli.progress import progress_bar
    from mavins.config import load
    from mavins.examples.scenarios import matched
    from mavins.results import check_folder
    from sitl.scenario import load as load_scenario

    if args.runs < 1:
        raise ConfigError(f"--runs {args.runs} makes no sense: give 1 or more")
    if args.seed < 0:
        raise ConfigError(f"--seed {args.seed} makes no sense: give 0 or more")
    if not 0.0 < args.duration < 1e6:
        raise ConfigError(f"--duration {args.duration:g} makes no sense: give seconds above 0")
    workers = workers_of(args)
    scenario, config = load_scenario(args.scenario), load(args.config)
    config = config if args.config is not None else matched(config, scenario)
    filters = filters_of(args.filters or config.filter)
    spreads = () if args.vary is None else read_spreads(args.vary)
    series = Series(scenario, config, tuple(filters), args.runs, args.duration, args.seed, spreads)
    check_folder(args.out)
    for name in FILES:
        # what an earlier series left is not to be taken for this one's, should it not end
        (args.out / name).unlink(missing_ok=True)
    for name in filters:
        ready(name)  # what compiles or loads does not count
    began = time.monotonic()
    quiet = args.verbosity < 0
    with progress_bar(f"montecarlo {args.scenario}", 1.0, quiet=quiet) as report:
        flown = montecarlo(series, workers, report)
    figures = write_series(args.out, args.scenario, series, flown)
    drawing = _draw(args.out / "montecarlo.png", by_filter(flown))
    if not quiet:
        print("\n".join(table_lines(figures)))
        print(pace_line(flown, time.monotonic() - began))
        print(f"written to {args.out}{drawing}")
    return 0


def _draw(path: Path, runs: dict[str, list[Flown]]) -> str:
    """Draw the series; returns what to say of it."""
    try:
        from mavins.campaign.series_plot import draw_series
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return "; for the figure install: pip install 'mavins[report]'"
    draw_series(path, runs)
    return ""
