"""`mavins observe`: which error states a flight makes observable, and when."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mavins.cli.choosing import add_choice, choice_of
from mavins.cli.compare import is_log
from mavins.errors import ConfigError

if TYPE_CHECKING:
    from mavins.config import Config
    from mavins.estimator.settings import Settings
    from mavins.evaluation.course import Course
    from mavins.evaluation.observability import Analysis

SUMMARY = """\
Which error states do the measurements of a flight make observable, in which manoeuvre, and when?
Along a scenario's true course, or along the estimate of a log."""

EPILOG = """\
examples:
  mavins observe square_spiral --states core --duration 400 --out result
  mavins observe quad_mission --without heading --out result
  mavins observe flight.tlog --window 5 --out result

A scenario is seen with its own noises (unless --config is given), a log with what the filter eskf fuses.
writes: OUT/observability.json and, with the extra 'report', OUT/observability.png"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "source", metavar="SCENARIO|LOG", help="a scenario's name or .yaml file, or a log"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the result folder")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in YAML")
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="seconds from the first state on (default: 150 of a scenario, all of a log)",
    )
    parser.add_argument(
        "--window", type=float, default=10.0, metavar="S", help="a segment's length (default: 10)"
    )
    parser.add_argument(
        "--states",
        choices=("all", "core", "configured"),
        default="all",
        help="all 19 errors of INS and GNSS (default), the 15 core ones, or those of the configuration",
    )
    parser.add_argument(
        "--without",
        default="",
        metavar="AIDINGS",
        help="comma-separated aidings to leave out, such as heading",
    )
    add_choice(parser)


def run(args: argparse.Namespace) -> int:
    """Analyse, print the tables, write the files."""
    from mavins import __version__
    from mavins.cli.progress import progress_bar
    from mavins.config import load
    from mavins.evaluation.observability import analyse, prior_sigmas
    from mavins.evaluation.observability_table import as_dict, table_lines
    from mavins.nav.layout import CORE, Layout
    from mavins.results import check_folder, write_json
    from mavins.whole_folder import written_whole

    without = tuple(filter(None, args.without.split(",")))
    _check(args, without)
    check_folder(args.out)
    settings, course = course_of(args, load(args.config))
    layouts = {
        "all": Layout.of((*CORE, "l_b", "tau")),
        "core": Layout.of(CORE),
        "configured": settings.states.layout(),
    }
    quiet = args.verbosity < 0
    with progress_bar(f"observe {Path(args.source).name}", 1.0, quiet=quiet) as report:
        analysis = analyse(
            course.without(without),
            layouts[args.states],
            prior_sigmas(settings),
            args.window,
            report,
        )
    if not quiet:
        print("\n".join(table_lines(analysis)))
    head = {"mavins": __version__, "source": args.source, "without": list(without)}
    with written_whole(args.out, "observability.json", ["observability.png"]) as aside:
        write_json(aside / "observability.json", head | as_dict(analysis))
        drawing = draw(aside, analysis)
    if not quiet:
        print(f"written to {args.out}{drawing}")
    return 0


def _check(args: argparse.Namespace, without: tuple[str, ...]) -> None:
    from mavins.aiding import REGISTRY

    for name in without:
        if name not in REGISTRY:
            raise ConfigError(
                f"--without: unknown aiding {name!r}; there are: {', '.join(REGISTRY)}"
            )
    for option in ("window", "duration"):
        value = getattr(args, option)
        if value is not None and not 1.0 <= value <= 1e5:
            raise ConfigError(f"--{option} {value:g} makes no sense: give 1 s or more")


def course_of(args: argparse.Namespace, config: Config) -> tuple[Settings, Course]:
    """The course of a scenario or a log, and the settings that go with it."""
    if is_log(args.source):
        from mavins.evaluation.course import estimated
        from mavins.sources import tape_of

        tape, _ = tape_of(Path(args.source), config, choice=choice_of(args))
        course = estimated(tape)
        return tape.settings, course if args.duration is None else course.until(args.duration)
    from mavins.examples.scenarios import course as true_course
    from mavins.examples.scenarios import matched
    from sitl.scenario import load

    scenario = load(args.source)
    settings = config if args.config else matched(config, scenario)
    return settings, true_course(settings, scenario, args.duration or 150.0)


def draw(out: Path, analysis: Analysis) -> str:
    """Draw the analysis; returns what to say of it."""
    try:
        from mavins.evaluation.observability_plot import draw_analysis
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return "; for the figure install: pip install 'mavins[report]'"
    draw_analysis(out / "observability.png", analysis)
    return ""
