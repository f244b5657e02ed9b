"""The configuration: every room's settings in one frozen tree, read from YAML and written back.

A room owns its settings dataclass; here it becomes one line of `Config`. Only cli, service, replay
and evaluation know this module: the rooms themselves are handed their settings.
"""

from __future__ import annotations

import dataclasses
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from mavins import __version__, typed_settings, yaml_text
from mavins.documented import Doc
from mavins.estimator.settings import Settings
from mavins.mavlink.limits import LimitSettings
from mavins.mavlink.settings import SessionSettings, StreamSettings
from mavins.mavlink.signing import SigningSettings
from mavins.mavlink.sources import SourceSettings

FilterName = Literal["eskf", "euler_ekf", "iekf", "ieskf", "srcdkf"]

_WIDTH = 100
_MISSING = dataclasses.MISSING


@dataclass(frozen=True, slots=True)
class Config(Settings):
    """All settings: the estimator's sections, and one line per further room."""

    filter: Annotated[FilterName, Doc("The filter.")] = "eskf"
    sources: SourceSettings = SourceSettings()
    streams: StreamSettings = StreamSettings()
    mavlink: SessionSettings = SessionSettings()
    limits: LimitSettings = LimitSettings()
    signing: SigningSettings = SigningSettings()


def load(path: Path | str | None = None, overrides: Mapping[str, Any] | None = None) -> Config:
    """Return the configuration of a YAML file (None: the defaults), with `overrides` laid over it.

    `overrides` is nested as the file is, and may use dotted keys: `{"gnss.delay": 0.18}`. Raises
    ConfigError: one line that names the file, the dotted path and what is allowed there.
    """
    data = {} if path is None else yaml_text.read(Path(path))
    config = typed_settings.build(Config, data, str(path))
    if not overrides:
        return config
    return typed_settings.build(Config, merged(data or {}, overrides), "override")


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Lay `over`, whose keys may be dotted, over `base`: sections merge, all else is replaced."""
    result = dict(base)
    for dotted, value in over.items():
        key, _, rest = dotted.partition(".")
        if rest:
            value = {rest: value}
        if isinstance(value, Mapping):
            below = result.get(key)
            value = merged(below if isinstance(below, Mapping) else {}, value)
        result[key] = value
    return result


def default_yaml() -> str:
    """The default configuration as commented YAML: the reference of every setting."""
    return to_yaml(Config())


def to_yaml(config: Any, commented: bool = True) -> str:
    """Write a configuration so that `load` gives it back, with the version in the first line.

    With `commented`, each key is preceded by what it means, its default and what is allowed.
    """
    lines = [f"# mavins {__version__}", *_section(config, 0, commented)]
    return "\n".join(lines) + "\n"


def _section(settings: Any, depth: int, commented: bool) -> Iterator[str]:
    indent = "  " * depth
    annotations = typed_settings.fields_of(type(settings))
    for field in dataclasses.fields(settings):
        if field.name not in annotations:
            continue
        annotation, value = annotations[field.name], getattr(settings, field.name)
        nested = typed_settings.section(annotation)
        if commented:
            if depth == 0:
                yield ""
            yield from _comment(annotation, field, nested, indent)
        if nested is None:
            yield f"{indent}{field.name}: {yaml_text.scalar(value)}"
        elif typed_settings.fields_of(nested):
            yield f"{indent}{field.name}:"
            yield from _section(value, depth + 1, commented)
        else:
            yield f"{indent}{field.name}: {{}}"


def _comment(
    annotation: Any, field: dataclasses.Field[Any], nested: type | None, indent: str
) -> Iterator[str]:
    _, notes = typed_settings.unwrap(annotation)
    text = " ".join(note.text for note in notes if isinstance(note, Doc))
    if nested is not None:
        text = text or _first_line(nested)
    else:
        default = (
            "" if field.default is _MISSING else f"; default {yaml_text.scalar(field.default)}"
        )
        text = f"{text} [{typed_settings.describe(annotation)}{default}]".lstrip()
    prefix = f"{indent}# "
    yield from textwrap.wrap(
        text, _WIDTH, initial_indent=prefix, subsequent_indent=prefix, break_on_hyphens=False
    )


def _first_line(cls: type) -> str:
    """The first line of a dataclass's docstring; the one that `dataclass` makes up says nothing."""
    text = inspect.getdoc(cls) or ""
    return "" if text.startswith(f"{cls.__name__}(") else text.partition("\n")[0]
