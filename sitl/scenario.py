"""Scenarios: one YAML file says where, how the vehicle moves and how wrong its sensors are."""

from __future__ import annotations

import dataclasses
import json
import math
import typing
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final

import yaml
from annotated_types import Ge, Le
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from mavins.errors import ScenarioError
from mavins.types import Origin
from sitl import plan, trajectory
from sitl.answers import Commands, StreamSettings
from sitl.gnss import GnssSettings
from sitl.heading import HeadingSettings
from sitl.imu import ImuSettings
from sitl.settings import Rate, Settings
from sitl.trajectory import Motion, Trajectory

DEFAULT: Final = "quad_mission"
_FOLDER: Final = Path(str(resources.files("sitl") / "scenarios"))
_TAGS: Final[dict[str, type]] = {
    "plan": trajectory.Plan,
    "track": trajectory.Track,
    "hover": plan.Hover,
    "take_off": plan.TakeOff,
    "land": plan.Land,
    "go": plan.Go,
    "turn": plan.Turn,
    "circle": plan.Circle,
    "figure8": plan.Figure8,
}
_KINDS: Final = {"kind": list(_TAGS)[:2], "do": list(_TAGS)[2:]}


@dataclass(frozen=True, slots=True)
class OriginSettings(Settings):
    """Where the vehicle stands at first: degrees, and m above mean sea level."""

    lat_deg: Annotated[float, Ge(-90.0), Le(90.0)]
    lon_deg: Annotated[float, Ge(-180.0), Le(180.0)]
    alt: float


@dataclass(frozen=True, slots=True)
class Scenario(Settings):
    """A motion at a place, and the sensors that see it; the truth is sampled at `truth_rate` Hz.

    `streams` are the messages that are sent at the start, `commands` says what comes of those that ask for others.
    """

    origin: OriginSettings
    motion: Motion
    description: str = ""
    imu: ImuSettings = field(default_factory=ImuSettings)
    gnss: GnssSettings = field(default_factory=GnssSettings)
    heading: HeadingSettings = field(default_factory=HeadingSettings)
    truth_rate: Rate = 50
    streams: StreamSettings = field(default_factory=StreamSettings)
    commands: Commands = "accept"

    def trajectory(self) -> Trajectory:
        """The true motion; built once for equal scenarios."""
        o = self.origin
        return trajectory.build(
            self.motion, Origin(math.radians(o.lat_deg), math.radians(o.lon_deg), o.alt)
        )


_ADAPTER: Final = TypeAdapter(Scenario)


def names() -> list[str]:
    """The names of the scenarios that come with the simulator."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def load(name: str) -> Scenario:
    """The scenario of a name, or of a YAML file where `name` ends in .yaml or .yml.

    Raises ScenarioError: an unknown name, an unreadable file, or an unknown key or wrong value with
    its dotted path.
    """
    if name.endswith((".yaml", ".yml")):
        path = Path(name)
    elif name in names():
        path = _FOLDER / f"{name}.yaml"
    else:
        raise ScenarioError(
            f"unknown scenario '{name}': use one of {', '.join(names())},"
            " or a file that ends in .yaml"
        )
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise ScenarioError(f"cannot read the scenario {path}: {reason}") from error
    try:
        return parse(data, path.parent)
    except ScenarioError as error:
        raise ScenarioError(f"{path}: {error}") from error


def parse(data: object, folder: Path = _FOLDER) -> Scenario:
    """The scenario that the mapping `data` describes; a track's file lies in `folder`."""
    try:
        # strict JSON: a list is a tuple and an int a float, but no text is a number
        scenario = _ADAPTER.validate_json(json.dumps(data, default=str))
    except ValidationError as error:
        raise ScenarioError("; ".join(_explain(e) for e in error.errors())) from error
    motion = scenario.motion
    if isinstance(motion, trajectory.Track):
        motion = dataclasses.replace(motion, file=str(folder / motion.file))
        scenario = dataclasses.replace(scenario, motion=motion)
    scenario.trajectory()
    return scenario


def _explain(error: ErrorDetails) -> str:
    """One line of a validation error: its dotted path and what is allowed there."""
    path = ""
    owner: type = Scenario
    for part in error["loc"]:
        if isinstance(part, int):
            path += f"[{part}]"
        elif part in _TAGS:
            owner = _TAGS[part]
        else:
            path += f".{part}" if path else part
            if error["type"] != "unexpected_keyword_argument" or part is not error["loc"][-1]:
                owner = _inner(owner, part)
    if error["type"] == "unexpected_keyword_argument":
        allowed = ", ".join(f.name for f in dataclasses.fields(owner))
        return f"unknown key {path}, allowed: {allowed}"
    if error["type"] == "missing":
        return f"missing key {path}"
    if error["type"].startswith("union_tag"):
        key, tags = error["ctx"]["discriminator"].strip("'"), error["ctx"].get("expected_tags")
        allowed = tags or ", ".join(repr(tag) for tag in _KINDS[key])
        return f"{path}.{key}: must be one of {allowed}"
    message = error["msg"].removeprefix("Value error, ").removeprefix("Input ")
    return f"{path or 'scenario'}: {message}, not {error['input']!r}"


def _inner(owner: type, name: str) -> Any:
    """The settings class of a field, or the owner itself where the field is a plain value."""
    hint = typing.get_type_hints(owner).get(name)
    return hint if dataclasses.is_dataclass(hint) else owner
