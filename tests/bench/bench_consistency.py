"""Mean NEES over seeds beside its 95 % band: noise-matched, and with the errors that the filter has no model of.

The filter is told the sensors' white noises in every case. Scale factors and quantization are those of the scenarios;
figure8 adds a GNSS error that wanders (0.5 m, 60 s), which no white noise stands for.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

from mavins.evaluation.consistency import band, share_inside
from mavins.filters import REGISTRY
from sitl.scenario import load

TEST = Path(__file__).resolve().parents[1] / "consistency" / "test_nees.py"
MATCHED = [("quad_mission", 145.0), ("square_spiral", 450.0), ("figure8", 110.0)]
CASES = [
    *((name, duration, True, 30, one) for one in REGISTRY for name, duration in MATCHED),
    ("quad_mission", 145.0, False, 10, "eskf"),
    ("figure8", 110.0, False, 10, "eskf"),
]


def of_the_test() -> ModuleType:
    """The module of the test: its runs are these."""
    spec = importlib.util.spec_from_file_location("test_nees", TEST)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    test = of_the_test()
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


if __name__ == "__main__":
    main()
