"""How many runs a minute: 5-minute flights at 100 Hz IMU, 5 Hz GNSS and 50 Hz heading, by one worker and by two.

CPU time per run says what a run costs whatever else the machine does; wall time says what a second worker gives. Pairs
of one and two workers take turns, and the median of their ratios counts: a machine's pace changes by the minute.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

from mavins.campaign.montecarlo import Series, montecarlo
from mavins.campaign.workers import Workers, ready
from mavins.config import Config
from mavins.examples.scenarios import matched
from sitl.scenario import load

DURATION = 300.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=16, help="of each series (default: 16)")
    parser.add_argument("--pairs", type=int, default=3, help="of series (default: 3)")
    parser.add_argument("--filter", default="eskf")
    args = parser.parse_args()
    scenario = load("quad_mission")
    scenario = dataclasses.replace(scenario, imu=dataclasses.replace(scenario.imu, rate=100))
    config = matched(Config(), scenario)
    series = Series(scenario, config, (args.filter,), args.runs, DURATION, 0)
    ready(args.filter)
    ratios, costs = [], []
    for pair in range(args.pairs):
        walls = []
        for workers in (1, 2):
            began = time.monotonic()
            flown = montecarlo(series, Workers(workers))
            walls.append(time.monotonic() - began)
            # a worker's first run also finds what is true at every instant: later runs know it
            simulation = np.median([f.simulation_cpu_s for f in flown])
            estimation = np.median([f.filter_cpu_s for f in flown])
            cost = float(np.sum([f.simulation_cpu_s + f.filter_cpu_s for f in flown])) / args.runs
            costs.append(cost)
            print(
                f"pair {pair}, {workers} worker(s): {args.runs} runs in {walls[-1]:.1f} s, "
                f"{60 * args.runs / walls[-1]:.1f} a minute; CPU per run {cost:.2f} s, "
                f"{60 / cost:.1f} a minute and core (simulation {simulation:.2f} s, "
                f"{args.filter} {estimation:.2f} s)",
                flush=True,
            )
        ratios.append(walls[0] / walls[1])
    print(
        f"median: {60 / float(np.median(costs)):.1f} runs a minute and core by CPU time; "
        f"two workers against one: {float(np.median(ratios)):.2f} x"
    )


if __name__ == "__main__":
    main()
