"""`mavins tune`: noises and the delay of GNSS from flight logs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavins.errors import ConfigError

if TYPE_CHECKING:
    from mavins.config import Config
    from mavins.evaluation.compare import Run
    from mavins.evaluation.tuning import Found, Tuning

SUMMARY = """\
Find the noises of gyro, accelerometer, GNSS and heading, and the delay of GNSS, under which the
measurements of one or several logs are likeliest to the filter. No truth is looked at. What is found
is taken only if the last part of each log, which the fit does not see, becomes likelier too."""

EPILOG = """\
examples:
  mavins tune flight.tlog --out tuned.yaml
  mavins tune monday.tlog tuesday.BIN --config vehicle.yaml --out tuned.yaml --jobs 4
  mavins replay flight.tlog --config tuned.yaml --out result

Each parameter comes with its 95 % interval; one that the logs say nothing of stays as it was.
Bias walks are held unless --all is given. exit status: 0, or 1 where nothing is to be changed"""

EXIT_KEPT = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="logs of one vehicle")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the configuration here")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings to begin with, YAML")
    parser.add_argument("--filter", metavar="NAME", help="the filter (default: the configured one)")
    parser.add_argument("--all", action="store_true", help="tune the bias walks too")
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes at a time (default: all cores)"
    )
    parser.add_argument(
        "--sysid", type=int, metavar="N", help="the vehicle of a log (default: the first)"
    )


def run(args: argparse.Namespace) -> int:
    """Tune, judge, print, and write the file where that is worth it."""
    from mavins.cli.progress import progress_bar
    from mavins.config import load
    from mavins.evaluation.replays import cores
    from mavins.evaluation.tuning import tune
    from mavins.results import write_text
    from mavins.sources import tape_of

    if args.jobs is not None and args.jobs < 1:
        raise ConfigError(f"--jobs {args.jobs} makes no sense: give 1 or more")
    config = load(args.config, {} if args.filter is None else {"filter": args.filter})
    tapes = [tape_of(log, config, args.sysid)[0] for log in args.logs]
    with progress_bar("tune", 1.0, quiet=args.verbosity < 0) as report:
        result = tune(tapes, config.filter, args.all, args.jobs or cores(), report)
    text = yaml_of(result, args.config)
    if args.verbosity >= 0:
        print("\n".join(lines_of(result)))
        for log in args.logs:
            print("\n".join(judged(log, config, text, args.sysid)))
    if not result.accepted:
        print(
            "the held-out part has not become likelier: these values fit this log's chance, nothing is written"
        )
        return EXIT_KEPT
    if args.out is not None:
        write_text(args.out, text)
        print(f"written to {args.out}")
    else:
        print(text, end="")
    return 0


def lines_of(result: Tuning) -> list[str]:
    """The table of parameters, and the likelihoods."""
    lines = [f"{'':<22}{'before':>10}{'after':>10}   95 % interval"]
    lines += [
        f"{found.parameter.path:<22}{found.before:>10.4g}{found.after:>10.4g}   {_words(found)}"
        for found in result.found
    ]
    for name, part in (("fitted", result.fit), ("held out", result.held_out)):
        lines.append(
            f"log likelihood of a measurement, {name}: {part.before:.3f} before, {part.after:.3f} after "
            f"({part.count} measurements)"
        )
    for name, every in zip(("fix", "heading"), result.thinning, strict=True):
        if every > 1:
            lines.append(
                f"{name} errors last: every {every}th was judged, and sigmas are {every**0.5:.1f} times as large "
                "for all of them (NIS below 1 is right then)"
            )
    lines.append(f"{result.replays} replays")
    return lines


def _words(found: Found) -> str:
    p = found.parameter
    low, high = max(found.interval[0], p.low), min(found.interval[1], p.high)
    text = f"{low:.3g} .. {high:.3g} {p.unit}"
    if not found.known:
        return f"{text}, hardly seen in the logs"
    return f"{text}, at its bound" if found.at_bound else text


def yaml_of(result: Tuning, base: Path | None) -> str:
    """The configuration that was there with what was found in it."""
    from mavins import __version__, yaml_text
    from mavins.config import merged
    from mavins.evaluation.tunable import claims

    data = {} if base is None else yaml_text.read(base) or {}
    values: dict[str, Any] = {**result.values, **claims(result.values)}
    notes = {
        f.parameter.path: f"{f.interval[0]:.3g} .. {f.interval[1]:.3g} (95 %), was {f.before:.4g}"
        for f in result.found
    }
    lines = yaml_text.block(merged(data, values), notes)
    return "\n".join([f"# mavins {__version__} tune", *lines]) + "\n"


def judged(log: Path, config: Config, text: str, sysid: int | None) -> list[str]:
    """NIS of each aiding, and errors where there is a truth, of a log before and after: read as a replay reads it."""
    from mavins import typed_settings, yaml_text
    from mavins.config import Config
    from mavins.evaluation.compare import run
    from mavins.sources import tape_of

    after = typed_settings.build(Config, yaml_text.parse(text), "tuned")
    runs: list[tuple[str, Run]] = []
    for name, settings in (("before", config), ("after", after)):
        tape, truth = tape_of(log, settings, sysid)
        runs.append((name, run(config.filter, tape.settings, tape, truth)))
    lines = [f"{log.name}"]
    for name, one in runs:
        nis = ", ".join(f"{key} {s / n:.2f}" for key, (s, n) in sorted(one.nis.items()) if n)
        lines.append(f"  {name:<7} NIS per row: {nis}")
    for name, one in runs:
        if one.errors is not None:
            rms = one.errors.summary().get("rms", {})
            said = [f"{key} " + "/".join(f"{v:.3f}" for v in row) for key, row in rms.items()]
            lines.append(f"  {name:<7} RMS error: {', '.join(said)}")
    return lines
