"""Mean NEES over seeds beside its 95 % band: noise-matched, and with the errors that the filter has no model of.

The filter is told the sensors' white noises in every case. Scale factors and quantization are those of the scenarios;
figure8 adds a GNSS error that wanders (0.5 m, 60 s), which no white noise stands for. With `--blocks`: of the states
that may be estimated besides, each with p, v and theta, and alone.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from mavins.evaluation.consistency import band, share_inside
from mavins.filters import REGISTRY
from sitl.scenario import load

TESTS = Path(__file__).resolve().parents[1] / "consistency"
MATCHED = [("quad_mission", 145.0), ("square_spiral", 450.0), ("figure8", 110.0)]
CASES = [
    *((name, duration, True, 30, one) for one in REGISTRY for name, duration in MATCHED),
    ("quad_mission", 145.0, False, 10, "eskf"),
    ("figure8", 110.0, False, 10, "eskf"),
]


BLOCK_RUNS, BLOCK_DURATION = 30, 145.0


def of_the_test(name: str) -> ModuleType:
    """The module of a test: its runs are these."""
    spec = importlib.util.spec_from_file_location(name, TESTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def filters() -> None:
    test = of_the_test("test_nees")
    print(
        f"{'filter':11s}{'scenario':15s}{'errors':>12s}{'runs':>6s}{'mean':>8s}{'band':>16s}{'inside':>9s}"
    )
    for name, duration, matched, runs, filter_name in CASES:
        scenario = load(name)
        if matched:
            scenario = test.without_model_errors(scenario)
        mean, _ = test.mean_nees(scenario, duration, runs, filter_name)
        low, high = band(9, runs)
        share = share_inside(mean, 9, runs)
        kind = "matched" if matched else "as they are"
        limits = f"{low:.2f} .. {high:.2f}"
        line = f"{filter_name:11s}{name:15s}{kind:>12s}{runs:6d}{mean.mean():8.2f}{limits:>16s}"
        print(f"{line}{100 * share:8.1f}%", flush=True)


def blocks(first_seed: int) -> None:
    test = of_the_test("test_blocks")
    print(f"{'states':21s}{'errors':>7s}{'runs':>6s}{'mean':>8s}{'band':>16s}{'inside':>9s}")
    for name, fly in test.BLOCKS.items():
        flown = [fly(first_seed + k, BLOCK_DURATION) for k in range(BLOCK_RUNS)]
        for first in (0, test.NAVIGATION):
            runs = [one.nees(first) for one in flown]
            # some start a second later: the same seconds of all, up to the end
            count = min(len(run) for run in runs)
            mean = np.mean([run[-count:] for run in runs], axis=0)
            dof = flown[0].e.shape[1] - first
            low, high = band(dof, BLOCK_RUNS)
            limits = f"{low:.2f} .. {high:.2f}"
            line = f"{name:21s}{dof:7d}{BLOCK_RUNS:6d}{mean.mean():8.2f}{limits:>16s}"
            print(f"{line}{100 * share_inside(mean, dof, BLOCK_RUNS):8.1f}%", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blocks", action="store_true", help="further states, not filters")
    parser.add_argument("--seed", type=int, default=0, help="of the first run (with --blocks)")
    args = parser.parse_args()
    if args.blocks:
        blocks(args.seed)
    else:
        filters()


if __name__ == "__main__":
    main()
