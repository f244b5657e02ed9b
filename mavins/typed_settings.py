"""Between plain data and frozen settings dataclasses: check, build, describe, write.

The annotations of a settings dataclass are all there is to say about it: `Literal` choices, ranges
by `annotated_types`, `Doc` for meaning and unit. Values are checked by pydantic (strictly: no text
or boolean passes for a number); unknown keys are found here, to tell the user which ones there are.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import json
import math
import types
from collections.abc import Iterator, Mapping
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import annotated_types

from mavins.documented import Doc
from mavins.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import TypeAdapter

Settings = TypeVar("Settings")

_COMPARISONS = (
    (annotated_types.Gt, "gt", ">"),
    (annotated_types.Ge, "ge", ">="),
    (annotated_types.Lt, "lt", "<"),
    (annotated_types.Le, "le", "<="),
)


def build(cls: type[Settings], data: Any, source: str) -> Settings:
    """Return the `cls` that `data`, a mapping as YAML gives it, stands for.

    Raises ConfigError: one line with `source`, the path of the first mistake and what is allowed.
    """
    from pydantic import ValidationError  # 0.1 s, which only those who load settings pay

    plain = _checked_keys(cls, data, source, ())
    known: type = cls  # mypy does not see that a type[Settings] can be a key of the cache
    try:
        # As JSON, pydantic's strict mode still takes a list for a tuple and an integer for a float.
        built: Settings = _adapter(known).validate_json(json.dumps(plain), strict=True)
    except ValidationError as errors:
        raise _explained(cls, errors.errors(include_url=False), source) from None
    return built


def describe(annotation: Any) -> str:
    """Say what a field takes: 'auto or a number in s', 'a number in m, > 0', 'true or false'."""
    _, notes = unwrap(annotation)
    unit = next((note.unit for note in notes if isinstance(note, Doc)), "")
    return _described(annotation, unit)


def fields_of(cls: type) -> dict[str, Any]:
    """The settings of a dataclass: field name -> full annotation, in order of definition."""
    hints = _hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls) if field.init}


def unwrap(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Split `Annotated[kind, *notes]`; any other annotation has no notes."""
    if get_origin(annotation) is Annotated:
        kind, *notes = get_args(annotation)
        return kind, tuple(notes)
    return annotation, ()


def limits(notes: tuple[Any, ...]) -> tuple[float, float]:
    """The lowest and the highest number that the notes of an annotation allow, or the bound just beyond it."""
    found = {"g": -math.inf, "l": math.inf}
    for note in _flat(notes):
        for kind, name, _ in _COMPARISONS:
            if isinstance(note, kind):
                found[name[0]] = float(getattr(note, name))
    return found["g"], found["l"]


def section(annotation: Any) -> type | None:
    """The dataclass of a field that is a section of its own, or None."""
    kind, _ = unwrap(annotation)
    return kind if isinstance(kind, type) and dataclasses.is_dataclass(kind) else None


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    return get_type_hints(cls, include_extras=True)


@functools.cache
def _adapter(cls: type) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(cls)


def _checked_keys(cls: type, data: Any, source: str, path: tuple[str, ...]) -> dict[str, Any]:
    """Refuse unknown keys and non-finite numbers at every level; an empty section is {}."""
    if data is None:
        return {}
    if not isinstance(data, Mapping):
        raise _error(source, path, f"{_shown(data)} is not allowed; expected {_keys(cls)}")
    allowed = fields_of(cls)
    plain: dict[str, Any] = {}
    for key, value in data.items():
        if key not in allowed:
            raise _error(source, (*path, str(key)), _unknown(str(key), list(allowed)))
        here = (*path, key)
        nested = section(allowed[key])
        if nested is not None:
            plain[key] = _checked_keys(nested, value, source, here)
        elif not _is_finite(value):
            expected = describe(allowed[key])
            raise _error(source, here, f"{_shown(value)} is not finite; expected {expected}")
        else:
            plain[key] = value
    return plain


def _is_finite(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(_is_finite(item) for item in value)
    return not isinstance(value, float) or math.isfinite(value)


def _unknown(key: str, allowed: list[str]) -> str:
    near = difflib.get_close_matches(key, allowed, n=1)
    guess = f" (did you mean {near[0]}?)" if near else ""
    return f"unknown key{guess}; allowed here: {', '.join(allowed)}"


def _explained(cls: type, errors: list[Any], source: str) -> ConfigError:
    """Turn pydantic's first complaint into our one line."""
    first = errors[0]
    path, annotation = _located(cls, first["loc"])
    if (
        first["type"] == "value_error"
    ):  # raised by a __post_init__ that checks fields against each other
        return _error(source, path, str(first["ctx"]["error"]))
    if first["type"] == "missing" and isinstance(first["input"], Mapping):
        return _error(source, path, f"is missing; expected {describe(annotation)}")
    alone = all(_located(cls, error["loc"])[0] != path for error in errors[1:])
    bound = _broken_bound(first) if alone else ""
    reason = f"must be {bound}" if bound else f"expected {describe(annotation)}"
    return _error(source, path, f"{_shown(first['input'])} is not allowed; {reason}")


def _located(cls: type, loc: tuple[int | str, ...]) -> tuple[tuple[str, ...], Any]:
    """The path of a complaint and the annotation there; parts inside a value are left out."""
    path: list[str] = []
    annotation: Any = cls
    for part in loc:
        nested = section(annotation)
        if nested is None:
            break
        path.append(str(part))
        annotation = fields_of(nested)[str(part)]
    return tuple(path), annotation


def _broken_bound(error: Any) -> str:
    context = error.get("ctx") or {}
    for _, name, sign in _COMPARISONS:
        if name in context:
            return f"{sign} {_number(context[name])}"
    return ""


def _error(source: str, path: tuple[str, ...], what: str) -> ConfigError:
    return ConfigError(f"{source}: {'.'.join(path)}: {what}" if path else f"{source}: {what}")


def _shown(value: Any) -> str:
    text = " ".join(str(value).split()) if not isinstance(value, str) else repr(value)
    if isinstance(value, bool) or value is None:
        text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _keys(cls: type) -> str:
    return f"a section with the keys {', '.join(fields_of(cls))}"


def _described(annotation: Any, unit: str) -> str:
    kind, notes = unwrap(annotation)
    origin = get_origin(kind)
    if origin is Literal:
        return _either([_word(choice) for choice in get_args(kind)])
    if origin in (Union, types.UnionType):
        # null comes last whichever way round the union was written
        members = sorted(get_args(kind), key=lambda member: member is types.NoneType)
        bounds = _bounds(notes)
        return _either([_described(member, unit) for member in members]) + bounds
    if origin is tuple:
        return _described_tuple(get_args(kind), unit)
    nested = section(kind)
    if nested is not None:
        return _keys(nested)
    bounds = _bounds(notes)
    measure = f" in {unit}" if unit and kind in (int, float) else ""
    return f"{_WORDS.get(kind, getattr(kind, '__name__', str(kind)))}{measure}{bounds}"


_WORDS: dict[Any, str] = {
    float: "a number",
    int: "an integer",
    bool: "true or false",
    str: "a text",
    types.NoneType: "null",
}


def _described_tuple(items: tuple[Any, ...], unit: str) -> str:
    kind, notes = unwrap(items[0])
    measure = f" in {unit}" if unit else ""
    noun = {float: "numbers", int: "integers", str: "texts"}.get(kind, "values")
    if items[-1] is Ellipsis:
        return f"a list of {noun}{measure}{_bounds(notes)}"
    return f"a list of {len(items)} {noun}{measure}{_bounds(notes)}"


def _bounds(notes: tuple[Any, ...]) -> str:
    """', > 0 and <= 1', or nothing."""
    parts = [
        f"{sign} {_number(getattr(note, name))}"
        for note in _flat(notes)
        for kind, name, sign in _COMPARISONS
        if isinstance(note, kind)
    ]
    return f", {' and '.join(parts)}" if parts else ""


def _flat(notes: tuple[Any, ...]) -> Iterator[Any]:
    for note in notes:
        if isinstance(note, annotated_types.GroupedMetadata):
            yield from note
        else:
            yield note


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _word(choice: Any) -> str:
    return json.dumps(choice) if not isinstance(choice, str) else choice


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
