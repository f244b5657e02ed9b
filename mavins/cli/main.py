"""The frame of the command line: find the command, parse, run, and turn errors into one clear line.

A command is a module with `SUMMARY`, `EPILOG`, `add_arguments(parser)` and `run(args) -> int`, and
one line in `COMMANDS`. Only the module of the command asked for is imported, so that `--help` and
`--version` answer at once and an optional dependency stays optional. `args.verbosity` is -1 for
`-q`, 0, 1 for `-v`, 2 for `-vv`.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Sequence
from typing import Final, Protocol, cast

from mavins import __version__
from mavins.errors import MavinsError

COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "serve": ("mavins.cli.serve", "run the navigation service on live MAVLink"),
    "status": (
        "mavins.cli.status_command",
        "show the status of the service that runs on this host",
    ),
    "sitl": ("mavins.cli.sitl", "fly the simulator: sensors and truth as MAVLink"),
    "replay": ("mavins.cli.replay", "run the estimator on a log"),
    "report": ("mavins.cli.report", "make the report of a result folder again"),
    "export": ("mavins.cli.export", "write a result folder in other formats"),
    "diff": ("mavins.cli.diff", "compare two result folders"),
    "compare": ("mavins.cli.compare", "run several filters on the same samples"),
    "montecarlo": (
        "mavins.cli.montecarlo",
        "fly a scenario many times, and judge the errors of all runs",
    ),
    "observe": ("mavins.cli.observe", "which states a flight makes observable, and when"),
    "play": ("mavins.cli.play", "send a log's packets into a UDP port at their own pace"),
    "tune": (
        "mavins.cli.tune",
        "noises and the GNSS delay that make a log's measurements likeliest",
    ),
    "allan": ("mavins.cli.allan", "an IMU's noises from a log in which it stands still"),
    "info": ("mavins.cli.info", "show what a log holds"),
    "config": ("mavins.cli.config", "show the configuration as commented YAML, or check a file"),
    "warmup": ("mavins.cli.warmup", "compile every kernel now, so that later starts are quick"),
    "example": ("mavins.cli.example", "reproduce an article's system and judge it"),
    "demo": ("mavins.cli.demo", "fly the simulator against the service and judge the estimate"),
}
"""Name -> (module, one line for the overview)."""

EXTRAS: Final = {
    "distributed": "dask",
    "mavsdk": "acceptance",
    "matplotlib": "report",
    "plotly": "report",
    "pyarrow": "export",
    "foxglove": "export",
    "zstandard": "logs",
}
"""Modules that come with an optional extra: import name -> the extra's name."""

EXIT_OK: Final = 0
EXIT_ERROR: Final = 2
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141

_EPILOG: Final = """\
examples:
  mavins demo                                    the service and the simulator, 30 s
  mavins serve --udp 14550                       a vehicle that sends to this host's port 14550
  mavins replay flight.tlog --out results        the same estimator on a recorded flight
  mavins config --default > mavins.yaml          every setting, with its meaning

`mavins COMMAND --help` tells more about each command."""


class Command(Protocol):
    """What a module of `mavins/cli/` offers to be a command."""

    SUMMARY: str
    EPILOG: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's options."""

    def run(self, args: argparse.Namespace) -> int:
        """Do the work and return the exit status."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status: 2 for a user's error, 130 for Ctrl-C."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        status = _dispatch(arguments)
        sys.stdout.flush()
        return status
    except MavinsError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; the interpreter's last flush must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("", "mavins", "sitl"):
            raise  # our own mistake, not a missing dependency
        return _fail(_missing(error.name or ""))
    except OSError as error:
        if error.filename is None:
            raise
        return _fail(f"{error.filename}: {error.strerror}")


def _dispatch(arguments: list[str]) -> int:
    name = _command_name(arguments)
    command = cast(Command, importlib.import_module(COMMANDS[name][0])) if name else None
    args = _parser(name, command).parse_args(arguments)
    args.verbosity = args.verbose + args.verbose_after - args.quiet - args.quiet_after
    _set_up_logging(args.verbosity)
    assert command is not None  # parse_args ends where no command was given
    return command.run(args)


def _command_name(arguments: list[str]) -> str | None:
    """The first word that is no option: the frame's own options take no values."""
    first = next((word for word in arguments if not word.startswith("-")), None)
    return first if first in COMMANDS else None


def _parser(chosen: str | None, command: Command | None) -> argparse.ArgumentParser:
    """The whole parser; all commands are named in it, and the chosen one is complete."""
    parser = argparse.ArgumentParser(
        prog="mavins",
        description="A MAVLink companion service: sensor messages in, a navigation solution out.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mavins {__version__}")
    _add_verbosity(parser, "")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, (_, overview) in COMMANDS.items():
        if name != chosen or command is None:
            subparsers.add_parser(name, help=overview)
            continue
        sub = subparsers.add_parser(
            name,
            help=overview,
            description=command.SUMMARY,
            epilog=command.EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_arguments(sub)
        _add_verbosity(sub, "_after")
    return parser


def _add_verbosity(parser: argparse.ArgumentParser, suffix: str) -> None:
    """Add -v and -q; before and after the command they count apart: argparse would forget one."""
    for flag, name, text in (
        ("-v", "verbose", "say more on stderr (twice: still more)"),
        ("-q", "quiet", "say less: no progress, errors only"),
    ):
        parser.add_argument(
            flag, f"--{name}", dest=name + suffix, action="count", default=0, help=text
        )


def _set_up_logging(verbosity: int) -> None:
    levels = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO, 2: logging.DEBUG}
    logging.basicConfig(
        level=levels[max(-1, min(2, verbosity))],
        format="mavins: %(levelname)s: %(message)s",
        stream=sys.stderr,
        force=True,
    )


def _missing(module: str) -> str:
    package = module.partition(".")[0]
    extra = EXTRAS.get(package)
    wanted = f"mavins[{extra}]" if extra else "mavins"
    return f"the module '{package}' is not installed; install it with: pip install '{wanted}'"


def _fail(message: str) -> int:
    """Say one line on stderr, whatever line breaks the message holds."""
    print(f"mavins: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_ERROR
