"""One vehicle's parameters: the configuration as it is by now, what it was, and where it is kept."""

from __future__ import annotations

import contextlib
import functools
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from mavins.config import Config, to_yaml
from mavins.errors import ParameterError
from mavins.parameters.metadata import metadata
from mavins.parameters.table import TABLE, get, put

Keeper = Callable[[Config], str]
"""Writes a configuration where the next start will read it; returns why that failed, or nothing."""


def file_keeper(path: Path | None) -> Keeper:
    """A keeper that replaces a YAML file, whole or not at all; without a file there is nowhere to write."""

    def keep(config: Config) -> str:
        if path is None:
            return "parameters are saved to the file of --config FILE: start with one"
        try:
            _replace(path.resolve(), to_yaml(config))
        except OSError as error:
            return f"cannot write {path}: {error.strerror or error}"
        return ""

    return keep


def _replace(path: Path, text: str) -> None:
    """Write beside, bring it to the disk, then rename: whoever reads finds the old file or the new one."""
    descriptor, aside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with open(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            mode = path.stat().st_mode & 0o777 if path.exists() else 0o644
            os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
        os.replace(aside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(aside)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


@functools.cache
def _described() -> bytes:
    return metadata(Config())


class ConfigStore:
    """What mavlink/parameters.py asks of a store, over a `Config`.

    `config` is what was asked for, also where it waits for a restart; `apply` puts into force what can be;
    `objection` says why a configuration cannot be put into force in time, as where a filter is not compiled yet.
    `load` and `reset` go back to what this store remembers, not to the file, so that a replay of the same requests
    does the same.
    """

    names = tuple(TABLE)

    def __init__(
        self,
        config: Config,
        apply: Callable[[Config], None],
        keep: Keeper,
        objection: Callable[[Config], str] = lambda config: "",
    ) -> None:
        self.config = config
        self._apply = apply
        self._keep = keep
        self._objection = objection
        self._started = self._saved = config

    def value(self, name: str) -> float:
        """The value of a parameter as it was asked for; ParameterError for an unknown name."""
        return get(self.config, name)

    def set(self, name: str, value: float) -> str:
        """Change a parameter; returns what there is to say about it, or nothing. ParameterError if it is refused."""
        wanted = self._wanted(name, value)
        if wanted is self.config:
            return ""
        self.config = wanted
        if not TABLE[name].live:
            return f"{name} is in force after a restart, once it is saved"
        self._apply(wanted)
        return ""

    def refuses(self, name: str, value: float) -> bool:
        """True where `set` would raise; nothing is changed."""
        try:
            self._wanted(name, value)
        except ParameterError:
            return True
        return False

    def _wanted(self, name: str, value: float) -> Config:
        wanted = put(self.config, name, value)
        if wanted is not self.config and (reason := self._objection(wanted)):
            raise ParameterError(f"{name}: {reason}")
        return wanted

    def described(self) -> bytes:
        """The table with the defaults of the program."""
        return _described()

    def save(self) -> str:
        """Keep the configuration for the next start; returns why that failed, or nothing."""
        reason = self._keep(self.config)
        if not reason:
            self._saved = self.config
        return reason

    def load(self) -> None:
        """Back to what was saved last, or begun with."""
        self._go_back(self._saved)

    def reset(self) -> None:
        """Back to what this run has begun with."""
        self._go_back(self._started)

    def _go_back(self, config: Config) -> None:
        if config != self.config:
            self.config = config
            self._apply(config)
