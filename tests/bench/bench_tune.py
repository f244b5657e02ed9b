"""What `tune` finds: simulated flights with noises wrong by x0.2 to x5, and the recordings against their truth.

The simulated sensors are white, and the fixes 0.12 s old. NEES is that of other flights, with what was found. How many
flights are tuned together is the first argument (default: 16; one takes 5 minutes on two cores), `recordings` as the
second leaves the simulation out.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

from mavins.config import Config, load
from mavins.evaluation.compare import run, together
from mavins.evaluation.replays import cores
from mavins.evaluation.tunable import put, tuned
from mavins.evaluation.tuning import Tuning, tune
from mavins.examples.scenarios import flight, matched
from mavins.sources import tape_of
from sitl.scenario import Scenario
from sitl.scenario import load as scenario_of

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = Path(os.environ.get("MAVINS_SHARED", ROOT.parent / "shared")) / "recordings"
DURATION = 145.0
LATENCY = 0.12
WRONG = {
    "imu.gyro_noise": 5.0,
    "imu.accel_noise": 0.2,
    "gnss.position_sigma": 0.2,
    "gnss.altitude_sigma": 5.0,
    "gnss.velocity_sigma": 5.0,
    "heading.sigma_deg": 0.2,
}
OTHERS = range(1000, 1010)


def of_the_consistency_test() -> ModuleType:
    path = ROOT / "tests" / "consistency" / "test_nees.py"
    spec = importlib.util.spec_from_file_location("test_nees", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def true_values(s: Scenario) -> dict[str, float]:
    return {
        "imu.gyro_noise": s.imu.gyro.noise,
        "imu.accel_noise": s.imu.accel.noise,
        "gnss.position_sigma": s.gnss.sigma_h,
        "gnss.altitude_sigma": s.gnss.sigma_v,
        "gnss.velocity_sigma": s.gnss.sigma_speed,
        "heading.sigma_deg": s.heading.sigma_deg,
    }


def white_scenario() -> Scenario:
    scenario = of_the_consistency_test().without_model_errors(scenario_of("quad_mission"))
    return dataclasses.replace(scenario, gnss=dataclasses.replace(scenario.gnss, latency=LATENCY))


def wrong_config(scenario: Scenario) -> Config:
    """The scenario's noises, each wrong by its factor, and no delay."""
    config = matched(Config(), scenario)
    wrong = {path: WRONG[path] * value for path, value in true_values(scenario).items()}
    return put(tuned(config, wrong), {"gnss.delay": 0.0})


def simulated(flights: int) -> None:
    scenario = white_scenario()
    config = wrong_config(scenario)
    tapes = [flight(config, scenario, seed, DURATION)[0].delayed(0.0) for seed in range(flights)]
    result = tune(tapes, "eskf", False, cores())
    print(f"quad_mission, {flights} flights of {DURATION:.0f} s")
    true = {**true_values(scenario), "gnss.delay": LATENCY}
    table(result, true)
    for name, settings in (("before", config), ("after", tuned(config, result.values))):
        runs = []
        for seed in OTHERS:
            tape, truth = flight(settings, scenario, seed, DURATION)
            runs.append(run("eskf", settings, tape.delayed(settings.gnss.delay), truth))
        said = together(runs)
        low, high = said["nees_band"]
        print(
            f"  {name}: NEES {said['nees']:.2f}, band {low:.2f} .. {high:.2f} over {len(runs)} other flights, "
            f"inside in {100 * said['nees_inside']:.0f} % of the seconds"
        )


def table(result: Tuning, true: dict[str, float]) -> None:
    for found in result.found:
        path, (low, high) = found.parameter.path, found.interval
        line = f"  {path:<22}{found.before:>10.4g}{found.after:>10.4g}   {low:.3g} .. {high:.3g}"
        if path in true:
            line += f"   true {true[path]:.4g}, ratio {found.after / true[path]:.2f}"
        print(line + ("" if found.known else "   hardly seen"))
    before, after = result.held_out.before, result.held_out.after
    print(f"  held out: {before:.2f} before, {after:.2f} after; thinning {result.thinning}")


def recorded(name: str, start: float, end: float) -> None:
    log = RECORDINGS / f"{name}.tlog.xz"
    config = load()
    tape, truth = tape_of(log, config)
    result = tune([tape], "eskf", False, cores())
    print(f"{name}, judged from {start:.0f} to {end:.0f} s")
    table(result, {})
    after = tuned(tape.settings, result.values)
    bounds = round(start * 1e6), round(end * 1e6)
    delay = result.values.get("gnss.delay", tape.delay())
    for label, settings, played in (
        ("before", tape.settings, tape),
        ("after", after, tape.delayed(delay)),
    ):
        said = together([run("eskf", settings, played, truth, bounds)])
        rms = {key: "/".join(f"{value:.3f}" for value in row) for key, row in said["rms"].items()}
        print(f"  {label}: RMS {rms}, NEES {said['nees']:.2f}")


if __name__ == "__main__":
    if sys.argv[2:] != ["recordings"]:
        simulated(int(sys.argv[1]) if len(sys.argv) > 1 else 16)
    recorded("px4_quad_mission", 60.0, 248.0)
    recorded("ap_copter_square_circle", 75.0, 240.0)
