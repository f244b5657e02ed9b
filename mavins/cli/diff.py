"""`mavins diff`: what moved between two results, against their sigmas."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mavins.errors import ConfigError

if TYPE_CHECKING:
    from mavins.evaluation.difference import Difference

SUMMARY = """\
Compare two result folders of one log: how far the estimates moved, in units and in sigmas of A, what
was fused and rejected, and which settings and figures differ."""

EPILOG = """\
examples:
  mavins diff before after
  mavins diff before after --tolerance 0.1     in a regression test
  mavins diff result result --filters eskf,iekf

exit status: 0; with --tolerance 1 where anything moved by more sigmas than that, or where one of them
has estimates that the other lacks; 2 for an error"""

EXIT_DIFFERENT: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("a", type=Path, metavar="A", help="a result folder")
    parser.add_argument("b", type=Path, metavar="B", help="another one")
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="SIGMAS",
        help="fail where anything moved by more than this; 0: nothing may (default: report only)",
    )
    parser.add_argument(
        "--filters",
        metavar="A,B",
        help="whose results (default: those that summary.json names)",
    )


def run(args: argparse.Namespace) -> int:
    """Read both, compare, print."""
    from mavins.evaluation.difference import difference
    from mavins.evaluation.result_folder import read_result

    if args.tolerance is not None and not 0.0 <= args.tolerance < math.inf:
        raise ConfigError(f"--tolerance {args.tolerance:g} makes no sense: give 0 or more sigmas")
    names = [None, None] if args.filters is None else args.filters.split(",")
    if len(names) != 2:
        raise ConfigError(f"--filters {args.filters}: give two, for A and B")
    a, b = read_result(args.a, names[0]), read_result(args.b, names[1])
    found = difference(a, b)
    if args.verbosity >= 0:
        print(f"A: {args.a} ({a.filter}), {len(a)} rows")
        print(f"B: {args.b} ({b.filter}), {len(b)} rows")
        print("\n".join(lines_of(found)))
    if args.tolerance is None or found.is_within(args.tolerance):
        return 0
    if args.verbosity >= 0:
        print(f"they differ by more than {args.tolerance:g} sigmas of A")
    return EXIT_DIFFERENT


def lines_of(found: Difference) -> Iterator[str]:
    """The difference as lines of text."""
    yield f"instants in both: {found.common}, in A only: {found.only_a}, in B only: {found.only_b}"
    yield f"{'B minus A':<26}{'RMS':>10}{'largest':>11}{'at s':>9}{'RMS':>12}{'largest':>9}   sigma"
    for m in found.moved:
        name = f"{m.quantity} {m.component}"
        yield (
            f"{name:<26}{m.rms:>10.4g}{m.largest:>11.4g}{m.at_s:>9.1f}{_sigmas(m.rms_sigmas):>12}"
            f"{_sigmas(m.largest_sigmas):>9}{_share(m.widened):>8}  {m.unit}"
        )
    for aiding, (a, b) in found.decisions.items():
        same = "" if a == b else "   <- differs"
        yield f"{aiding}: fused {a[0]} and {b[0]}, rejected {a[1]} and {b[1]}{same}"
    for heading, pairs in (("settings", found.settings), ("figures", found.figures)):
        if pairs:
            yield f"{heading} that differ, A and B:"
        for name, (value_a, value_b) in pairs.items():
            yield f"  {name}: {_text(value_a)}   {_text(value_b)}"


def _sigmas(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g} σ"


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.3g} %"


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "/".join(map(_text, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
