"""YAML text in, plain Python data out, by the rules of YAML 1.2's core schema.

PyYAML speaks YAML 1.1, where `off` and `no` are booleans, `1e-3` is a text, `12:30` is a number and
`010` is eight. None of that is what the author of a settings file means, so scalars are resolved
here anew. A key written twice and an alias are refused: both hide a value from its reader.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import yaml

from mavins.errors import ConfigError

_NULL: Final = re.compile(r"(?:~|null|Null|NULL|)\Z")
_BOOL: Final = re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")
_INT: Final = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT: Final = re.compile(
    r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z"
)


class _Loader(yaml.SafeLoader):
    """A safe loader whose implicit types are those of YAML 1.2, without aliases."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  (PyYAML's own way to say it)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases are not used here", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = str(key_node.value)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} is written twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_decimal(self, node: yaml.ScalarNode) -> int:
        return int(node.value)


for _tag, _pattern in (("null", _NULL), ("bool", _BOOL), ("int", _INT), ("float", _FLOAT)):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", _pattern, None)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_decimal)


def parse(text: str, source: str = "<text>") -> Any:
    """Return the data of one YAML document; ConfigError names `source`, line and column."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{source}:{mark.line + 1}:{mark.column + 1}" if mark else source
        raise ConfigError(f"{place}: not valid YAML: {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise ConfigError(f"{source}: not valid YAML: nested too deeply") from None


def read(path: Path) -> Any:
    """Return the data of a YAML file; ConfigError says why it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start})") from None
    return parse(text, str(path))


def scalar(value: object) -> str:
    """Write a value so that `parse` reads it back: null, boolean, number, text or list of them."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(scalar(item) for item in value)}]"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return value if _is_plain(value) else _quoted(value)
    raise TypeError(f"a setting cannot be a {type(value).__name__}")


def block(
    data: Mapping[str, Any], notes: Mapping[str, str], path: str = "", depth: int = 0
) -> Iterator[str]:
    """The lines of a nested mapping; behind a value stands the note of its dotted path, as a comment."""
    indent = "  " * depth
    for key, value in data.items():
        here = f"{path}{key}"
        if isinstance(value, Mapping) and value:
            yield f"{indent}{key}:"
            yield from block(value, notes, f"{here}.", depth + 1)
        else:
            shown = "{}" if isinstance(value, Mapping) else scalar(value)
            yield f"{indent}{key}: {shown}" + (f"  # {notes[here]}" if here in notes else "")


def _is_plain(text: str) -> bool:
    """Whether `text` needs no quotes: a word or a path that cannot be taken for something else."""
    if not re.fullmatch(r"[A-Za-z_/.][A-Za-z0-9_/.+-]*", text):
        return False
    return not any(pattern.match(text) for pattern in (_NULL, _BOOL, _INT, _FLOAT))


def _quoted(text: str) -> str:
    written: str = yaml.dump(text, default_style='"', allow_unicode=True, width=2**31)
    return written.removesuffix("\n")
