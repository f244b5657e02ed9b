"""`mavins compare`: filters side by side on the same samples."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavins.cli.choosing import add_choice, choice_of
from mavins.errors import ConfigError
from mavins.filters import REGISTRY

if TYPE_CHECKING:
    from mavins.config import Config
    from mavins.estimator.settings import Settings
    from mavins.evaluation.compare import Run
    from mavins.evaluation.tape import Tape
    from mavins.logs.truth import Truth

SUMMARY = """\
Run several filters on the same samples, of a log or of simulated flights, and compare them: errors,
consistency (NEES, NIS), CPU time per IMU sample and time to converge."""

EPILOG = """\
examples:
  mavins compare flight.tlog --filters all --out result --start 60 --end 248
  mavins compare quad_mission --filters eskf,iekf --seeds 30 --out result
  mavins compare my_scenario.yaml --duration 120 --out result

Simulated flights run with filter noises that match the scenario's sensors, unless --config is given.
writes: OUT/compare.json and, with the extra 'report', OUT/compare.png"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "source", metavar="LOG|SCENARIO", help="a log, or a scenario's name or .yaml file"
    )
    parser.add_argument(
        "--filters",
        default="all",
        metavar="NAMES",
        help=f"comma-separated, or all (default): {', '.join(REGISTRY)}",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the result folder")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    parser.add_argument(
        "--seeds", type=int, default=1, metavar="N", help="simulated flights (default: 1)"
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=150.0,
        metavar="S",
        help="seconds of each simulated flight (default: 150)",
    )
    parser.add_argument("--start", type=float, metavar="S", help="judge from this boot time on, s")
    parser.add_argument("--end", type=float, metavar="S", help="judge up to this boot time, s")
    parser.add_argument(
        "--sysid", type=int, metavar="N", help="the vehicle of a log (default: the first)"
    )
    add_choice(parser)


def run(args: argparse.Namespace) -> int:
    """Run all filters on all flights, print the table, write the files."""
    from mavins import __version__
    from mavins.cli.progress import progress_bar
    from mavins.config import load
    from mavins.evaluation.compare import together
    from mavins.evaluation.compare_table import table_lines
    from mavins.results import check_folder, write_json
    from mavins.whole_folder import written_whole

    filters = filters_of(args.filters)
    if args.seeds < 1:
        raise ConfigError(f"--seeds {args.seeds} makes no sense: give 1 or more")
    check_folder(args.out)
    config = load(args.config)
    bounds_us = (
        round((args.start or 0.0) * 1e6),
        2**62 if args.end is None else round(args.end * 1e6),
    )
    runs: dict[str, list[Run]] = {name: [] for name in filters}
    quiet = args.verbosity < 0
    drawn: Truth | None = None
    with progress_bar(f"compare {Path(args.source).name}", 1.0, quiet=quiet) as report:
        if is_log(args.source):
            from mavins.sources import tape_of

            tape, truth = tape_of(Path(args.source), config, args.sysid, choice=choice_of(args))
            flights = [(tape.settings, tape, truth)]
            results = run_all(filters, flights, bounds_us)
            count = 1
        else:
            results = simulated(args, config, filters, bounds_us)
            count = args.seeds
        for done, (truth, one) in enumerate(results, 1):
            runs[one.filter].append(one)
            drawn = drawn or truth
            report(done / (count * len(filters)))
    figures = {name: together(found) for name, found in runs.items()}
    if not quiet:
        print("\n".join(table_lines(figures)))
    with written_whole(args.out, "compare.json", ["compare.png"]) as aside:
        write_json(
            aside / "compare.json",
            {
                "mavins": __version__,
                "source": args.source,
                "seeds": None if is_log(args.source) else args.seeds,
                "units": {"pos": "m", "vel": "m/s", "att": "deg", "cpu_us": "us per IMU sample"},
                "filters": figures,
            },
        )
        drawing = draw(aside, {name: found[0] for name, found in runs.items()}, drawn)
    if not quiet:
        print(f"written to {args.out}{drawing}")
    return 0


def filters_of(text: str) -> list[str]:
    """The filters that were asked for, each once."""
    names = list(REGISTRY) if text == "all" else list(dict.fromkeys(text.split(",")))
    for name in names:
        if name not in REGISTRY:
            known = ", ".join(REGISTRY)
            raise ConfigError(f"--filters: unknown filter {name!r}; there are: {known}, or all")
    return names


def is_log(source: str) -> bool:
    """True for a path that holds a log rather than a scenario."""
    path = Path(source)
    return path.exists() and path.suffix not in (".yaml", ".yml")


def run_all(
    filters: Sequence[str],
    flights: Sequence[tuple[Settings, Tape, Truth | None]],
    bounds_us: tuple[int, int],
) -> Any:
    """(truth, run) of every filter on every flight, one after the other: CPU times are comparable only so."""
    from mavins.evaluation.compare import run as run_filter
    from mavins.warmup import compile_all

    for name in filters:
        # what compiles or loads here does not count as the filter's time
        compile_all(lambda line: print(line, file=sys.stderr, flush=True), name)
    for config, tape, truth in flights:
        for name in filters:
            yield truth, run_filter(name, config, tape, truth, bounds_us)


def simulated(
    args: argparse.Namespace, config: Config, filters: Sequence[str], bounds_us: tuple[int, int]
) -> Any:
    """(truth, run) of every filter on every seed of a scenario; seeds run side by side."""
    from concurrent.futures import ProcessPoolExecutor

    from sitl.scenario import load

    scenario = load(args.source)
    with ProcessPoolExecutor() as pool:
        jobs = [
            pool.submit(
                _seed,
                scenario,
                seed,
                args.duration,
                config,
                args.config is None,
                list(filters),
                bounds_us,
            )
            for seed in range(args.seeds)
        ]
        for job in jobs:
            yield from job.result()


def _seed(
    scenario: Any,
    seed: int,
    duration: float,
    config: Config,
    match: bool,
    filters: list[str],
    bounds_us: tuple[int, int],
) -> list[tuple[Truth, Run]]:
    from mavins.examples.scenarios import flight, matched

    settings = matched(config, scenario) if match else config
    tape, truth = flight(settings, scenario, seed, duration)
    return list(run_all(filters, [(settings, tape, truth)], bounds_us))


def draw(out: Path, runs: dict[str, Run], truth: Truth | None) -> str:
    """Draw the first flight; returns what to say of it."""
    try:
        from mavins.evaluation.compare_plot import draw_runs
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return "; for the figure install: pip install 'mavins[report]'"
    draw_runs(out / "compare.png", runs, truth)
    return ""
