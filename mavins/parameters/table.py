"""The table of parameters, made from the settings' own annotations, and the way between settings and numbers.

On the wire every value is a 32-bit float: false and true are 0 and 1, a choice is its place in the list, and `AUTO`
stands for auto. A number that comes back as it went out changes nothing: 0.015 stays 0.015.
"""

from __future__ import annotations

import ctypes
import dataclasses
import math
import types
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final, Literal, Union, get_args, get_origin

import numpy as np

from mavins import typed_settings
from mavins.config import Config
from mavins.documented import Doc
from mavins.errors import ConfigError, ParameterError
from mavins.parameters.names import NAMES, NEEDS_RESTART, within

AUTO: Final = -1000.0
"""The value of auto, which a number never takes that has a range."""
_FLOAT32_MAX: Final = float(np.finfo(np.float32).max)

Kind = Literal["number", "integer", "switch", "choice"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: a setting, or the component of a vector that `component` says (-1: no vector).

    `low` and `high` are the ends of its range; `choices` are the words that the values 0, 1, ... stand for; `automatic`
    says whether it takes AUTO; `live` whether a change is in force at once; `allowed` tells a person what it takes.
    """

    name: str
    path: str
    component: int
    kind: Kind
    unit: str
    text: str
    low: float
    high: float
    choices: tuple[str, ...]
    automatic: bool
    live: bool
    allowed: str


def wire(value: float) -> float:
    """A number as a 32-bit float carries it."""
    return ctypes.c_float(min(max(value, -_FLOAT32_MAX), _FLOAT32_MAX)).value


def get(config: Config, name: str) -> float:
    """The value of a parameter; ParameterError for an unknown name."""
    parameter = _named(name)
    value = attrgetter(parameter.path)(config)
    if parameter.automatic and value == "auto":
        return AUTO
    if parameter.component >= 0:
        value = value[parameter.component]
    return float(parameter.choices.index(value) if parameter.kind == "choice" else value)


def put(config: Config, name: str, value: float) -> Config:
    """The configuration with another value of a parameter; the same object where the value is the one it has.

    Raises ParameterError: one line that names the parameter and what it takes.
    """
    parameter = _named(name)
    if math.isfinite(value) and wire(value) == wire(get(config, name)):
        return config
    before = attrgetter(parameter.path)(config)
    setting = _setting(parameter, value)
    if parameter.component >= 0 and setting != "auto":
        vector = [0.0, 0.0, 0.0] if before == "auto" else list(before)
        vector[parameter.component] = setting
        setting = vector
    try:
        changed: Config = _with(config, parameter.path.split("."), setting, name)
    except (ConfigError, ValueError) as error:
        if not (parameter.low <= value <= parameter.high):
            raise _refused(parameter, value) from None
        raise ParameterError(str(error)) from None
    return changed


def _with(node: Any, path: list[str], setting: Any, source: str) -> Any:
    """A tree of settings with another value at a path, its section checked anew."""
    name, *rest = path
    if rest:
        below = _with(getattr(node, name), rest, setting, source)
        return dataclasses.replace(node, **{name: below})
    return typed_settings.build(type(node), dataclasses.asdict(node) | {name: setting}, source)


def _refused(parameter: Parameter, value: float) -> ParameterError:
    return ParameterError(
        f"{parameter.name}: {value:g} is not allowed; expected {parameter.allowed}"
    )


def _named(name: str) -> Parameter:
    if name not in TABLE:
        raise ParameterError(f"no parameter is called {name!r}")
    return TABLE[name]


def _setting(parameter: Parameter, value: float) -> Any:
    """What a number stands for; its range is checked with all others when a configuration is made of it."""
    if parameter.automatic and value == AUTO:
        return "auto"
    if not math.isfinite(value):
        raise _refused(parameter, value)
    if parameter.kind == "number":
        # the shortest decimal that is this 32-bit float: what a person has meant by it
        return float(str(np.float32(wire(value))))
    if value != int(value):
        raise _refused(parameter, value)
    if parameter.kind == "integer":
        return int(value)
    words: tuple[Any, ...] = (False, True) if parameter.kind == "switch" else parameter.choices
    if not 0 <= value < len(words):
        raise _refused(parameter, value)
    return words[int(value)]


# ---- the table -------------------------------------------------------------------------------------------------


def leaves(cls: type, above: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and annotation of every setting of a tree of sections."""
    for name, annotation in typed_settings.fields_of(cls).items():
        section = typed_settings.section(annotation)
        if section is None:
            yield f"{above}{name}", annotation
        else:
            yield from leaves(section, f"{above}{name}.")


def _members(annotation: Any) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """The single types of a union, each with the notes about it."""
    kind, notes = typed_settings.unwrap(annotation)
    if get_origin(kind) in (Union, types.UnionType):
        for member in get_args(kind):
            for inner, inner_notes in _members(member):
                yield inner, (*inner_notes, *notes)
    elif get_origin(kind) is tuple:
        inner, inner_notes = typed_settings.unwrap(get_args(kind)[0])
        yield inner, (*inner_notes, *notes)
    else:
        yield kind, notes


def _parameters(path: str, annotation: Any, names: str | tuple[str, ...]) -> Iterator[Parameter]:
    """The parameters that a setting makes."""
    words: list[str] = []
    kinds: list[tuple[Kind, tuple[Any, ...]]] = []
    for member, notes in _members(annotation):
        if get_origin(member) is Literal:
            words += get_args(member)
        else:
            kinds.append((_KINDS[member], notes))
    choices = tuple(word for word in words if word != "auto")
    kind, notes = kinds[0] if kinds else ("choice", ())
    _, outer = typed_settings.unwrap(annotation)
    doc = next((note for note in outer if isinstance(note, Doc)), Doc(""))
    low, high = typed_settings.limits(notes)
    if kind in ("switch", "choice"):
        low, high = 0.0, float(max(len(choices), 2) - 1)
    for k, name in enumerate([names] if isinstance(names, str) else names):
        yield Parameter(
            name=name,
            path=path,
            component=-1 if isinstance(names, str) else k,
            kind=kind,
            unit=doc.unit,
            text=doc.text,
            low=low,
            high=high,
            choices=choices,
            automatic="auto" in words,
            live=not within(path, NEEDS_RESTART),
            allowed=_allowed(kind, annotation, choices, "auto" in words),
        )


_KINDS: Final[dict[Any, Kind]] = {float: "number", int: "integer", bool: "switch"}


def _allowed(kind: Kind, annotation: Any, choices: tuple[str, ...], automatic: bool) -> str:
    if kind in ("switch", "choice"):
        words = ("false", "true") if kind == "switch" else choices
        meanings = [f"{k} ({word})" for k, word in enumerate(words)]
        if automatic:
            meanings.append(f"{AUTO:g} (auto)")
        return f"{', '.join(meanings[:-1])} or {meanings[-1]}"
    text = typed_settings.describe(annotation).replace("a list of 3 numbers", "a number")
    return text.replace("auto", f"{AUTO:g} (auto)", 1) if automatic else text


def _table() -> dict[str, Parameter]:
    annotations = dict(leaves(Config))
    made = (p for path, names in NAMES.items() for p in _parameters(path, annotations[path], names))
    return {parameter.name: parameter for parameter in made}


TABLE: Final = _table()
"""Name -> parameter, in the order of their indices on the wire."""
