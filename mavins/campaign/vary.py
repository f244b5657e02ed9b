"""What differs between the runs of a series: parameters of the scenario or of the configuration, drawn per run.

    scenario.imu.gyro.noise: {loguniform: [1e-4, 1e-3]}
    scenario.gnss.lever_arm.0: {uniform: [-0.1, 0.1]}
    scenario.motion.segments.2.speed: {normal: [8, 1]}
    config.gnss.delay: {choice: [0.0, 0.1, 0.2]}

A draw depends on the series' seed, the run and the parameter's name alone: neither on the other parameters nor on who
flies the run.
"""

from __future__ import annotations

import dataclasses
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins import typed_settings, yaml_text
from mavins.config import Config, to_yaml
from mavins.errors import ConfigError, ScenarioError
from sitl import scenario as scenarios
from sitl.scenario import Scenario

ROOTS: Final = ("scenario", "config")
KINDS: Final = ("uniform", "normal", "loguniform", "choice")


@dataclass(frozen=True, slots=True)
class Spread:
    """A parameter's distribution.

    `kind` with its `values`: uniform and loguniform [low, high], normal [mean, sigma], choice any values.
    """

    path: str
    kind: str
    values: tuple[Any, ...]

    def draw(self, seed: int, run: int) -> Any:
        """The parameter's value in a run."""
        rng = np.random.default_rng([seed, run, zlib.crc32(self.path.encode())])
        match self.kind:
            case "uniform":
                return float(rng.uniform(*self.values))
            case "normal":
                return float(rng.normal(*self.values))
            case "loguniform":
                low, high = self.values
                return math.exp(rng.uniform(math.log(low), math.log(high)))
            case _:
                return self.values[int(rng.integers(len(self.values)))]


def read_spreads(path: Path) -> tuple[Spread, ...]:
    """The spreads of a YAML file; ConfigError: one line that names the parameter and what is allowed."""
    data = yaml_text.read(path)
    if not isinstance(data, Mapping) or not data:
        raise ConfigError(
            f"{path}: expected lines like  scenario.gnss.latency: {{uniform: [0, 0.2]}}"
        )
    return tuple(_spread(str(path), str(name), what) for name, what in data.items())


def _spread(file: str, name: str, what: Any) -> Spread:
    def refuse(reason: str) -> ConfigError:
        return ConfigError(f"{file}: {name}: {reason}")

    if name.partition(".")[0] not in ROOTS:
        raise refuse("begins with neither 'scenario.' nor 'config.'")
    if not isinstance(what, Mapping) or len(what) != 1:
        raise refuse(
            f"expected one of {', '.join(KINDS)} with its values, as in {{uniform: [0, 1]}}"
        )
    ((kind, values),) = what.items()
    if kind not in KINDS:
        raise refuse(f"unknown distribution {kind!r}; there are: {', '.join(KINDS)}")
    if not isinstance(values, Sequence) or isinstance(values, str) or not values:
        raise refuse(f"{kind} takes a list")
    if kind == "choice":
        return Spread(name, kind, tuple(values))
    try:
        low, high = (float(value) for value in values)
    except (TypeError, ValueError):
        raise refuse(f"{kind} takes two numbers") from None
    if not math.isfinite(low) or not math.isfinite(high):
        raise refuse(f"{kind} takes two finite numbers")
    if kind == "normal" and high < 0.0:
        raise refuse("normal takes [mean, sigma], sigma of 0 or above")
    if kind != "normal" and low > high:
        raise refuse(f"{kind} takes [low, high]")
    if kind == "loguniform" and low <= 0.0:
        raise refuse("loguniform takes numbers above 0")
    return Spread(name, kind, (low, high))


def drawn(spreads: Sequence[Spread], seed: int, run: int) -> dict[str, Any]:
    """All parameters of a run."""
    return {spread.path: spread.draw(seed, run) for spread in spreads}


def varied(
    scenario: Scenario, config: Config, values: Mapping[str, Any]
) -> tuple[Scenario, Config]:
    """Scenario and configuration with other values at dotted paths; ConfigError where one is not allowed."""
    roots = {name.partition(".")[0] for name in values}
    trees: dict[str, Any] = {}
    if "scenario" in roots:
        trees["scenario"] = json.loads(json.dumps(dataclasses.asdict(scenario)))
    if "config" in roots:
        trees["config"] = yaml_text.parse(to_yaml(config, commented=False))
    for name, value in values.items():
        _put(trees, name, value)
    try:
        if "scenario" in roots:
            scenario = scenarios.parse(trees["scenario"])
        if "config" in roots:
            config = typed_settings.build(Config, trees["config"], "config")
        return scenario, config
    except (ConfigError, ScenarioError) as error:
        shown = ", ".join(f"{name} = {value}" for name, value in values.items())
        raise ConfigError(f"--vary drew {shown}: {error}") from None


def _put(tree: Any, name: str, value: Any) -> None:
    """Replace what is there at a dotted path; numbers are places in lists."""
    *way, last = name.split(".")
    try:
        for step in way:
            tree = tree[int(step) if isinstance(tree, list) else step]
        place = int(last) if isinstance(tree, list) else last
        tree[place]  # what is not there is not to be put there
        tree[place] = value
    except (KeyError, IndexError, ValueError, TypeError):
        raise ConfigError(f"--vary: there is no {name}") from None
