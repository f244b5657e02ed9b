"""What a replay would use and write, without running it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

from mavins import exports
from mavins.config import Config
from mavins.estimator.estimator import Estimator
from mavins.evaluation.tape import Tape
from mavins.logs.content import kind_of
from mavins.replay import ReplayOptions
from mavins.results import SUMMARY
from mavins.sources import Source, source_of

_ORDER: Final = "imu gnss heading mag baro"


def lines_of(log: Path, out: Path | None, config: Config, options: ReplayOptions) -> Iterator[str]:
    """Lines for people: the log, what would be fed, what `auto` comes to, and which files there would be."""
    source = source_of(log, config, options.sysid, options.choice)
    tape = Tape(source.config)
    source.feed(tape, lambda _: None)
    told = source.summary(Estimator(source.config, config.filter))
    vehicle = f", vehicle {told['sysid']}" if "sysid" in told else ""
    yield f"{log}: {kind_of(log)}{vehicle}, {source.seconds:.1f} s"
    lost = ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in source.damage.items() if n)
    if lost:
        yield f"damage: {lost}"
    yield from _fed(tape, told, source.seconds)
    for key, judge in (("truth", source.truth), ("reference", source.reference)):
        if judge is not None:
            yield f"{key}: {judge.source}, {len(judge)} samples, for evaluation only"
    yield f"filter: {config.filter}, states: {', '.join(config.states.layout().blocks)}"
    yield from _decided(config, source, told)
    yield from _delay(tape, config)
    yield from _written(out, config, options)


def _fed(tape: Tape, told: dict[str, Any], seconds: float) -> Iterator[str]:
    """What would be fed, from where, and how often."""
    counts: Counter[tuple[str, str]] = Counter()
    for name, what in tape.feeds:
        table = name.removeprefix("feed_")
        if name == "feed_imu":
            imu = told["imu"]
            counts["imu", "" if imu is None else imu["message"]] += len(what)
        elif name.startswith("feed_"):
            counts[table, what.source] += 1
        else:
            counts[name.replace("_", " "), ""] += 1
    for (table, name), n in sorted(counts.items(), key=lambda item: _ORDER.find(item[0][0])):
        yield f"{table}: {name + ', ' if name else ''}{n} ({n / max(seconds, 1e-6):.1f} Hz)"
    for table in ("imu", "gnss"):
        if table not in {kind for kind, _ in counts}:
            yield f"{table}: none, so that there would be no estimate"
    dropped = ", ".join(f"{n} {reason}" for reason, n in told["dropped"].items())
    if dropped:
        yield f"not used: {dropped}"


def _decided(config: Config, source: Source, told: dict[str, Any]) -> Iterator[str]:
    """What the log decides of the settings that are `auto`."""
    for path, value in _autos(config):
        found = _at(source.config, path)
        if path[0] == "sources" and "sysid" in told and told["sources"]:
            found = told["sources"].get(path[1], "auto")
        if found != value:
            yield f"{'.'.join(path)}: auto, here {_text(found)}"


def _autos(settings: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The paths of all settings that are `auto`."""
    for f in fields(settings):
        value = getattr(settings, f.name)
        if is_dataclass(value):
            yield from _autos(value, (*path, f.name))
        elif value == "auto":
            yield (*path, f.name), value


def _text(value: Any) -> str:
    """A setting's value, for people."""
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_text, value)) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _at(settings: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        settings = getattr(settings, name)
    return settings


def _delay(tape: Tape, config: Config) -> Iterator[str]:
    """The delay of GNSS, and whether it is estimated."""
    delays = sorted({fix.delay for name, fix in tape.feeds if name == "feed_gnss"})
    if delays:
        estimated = "estimated from there on" if "tau" in config.states.layout().blocks else "fixed"
        yield f"delay of GNSS: {', '.join(f'{delay:g}' for delay in delays)} s, {estimated}"


def _written(out: Path | None, config: Config, options: ReplayOptions) -> Iterator[str]:
    """The files that there would be."""
    folder = (out or Path("DIR")) / config.filter
    names = ["estimates.csv", "innovations.csv", "evidence.npz", "config.yaml"]
    names += ["smoothed.csv"] if options.smooth else []
    for name in options.exports:
        names += exports.REGISTRY[name].FILES if name in exports.REGISTRY else [exports.OUTPUT_TLOG]
    yield f"would write {(out or Path('DIR')) / SUMMARY}, and into {folder}: {', '.join(names)}"
    if out is not None and (out / SUMMARY).exists():
        yield f"in place of the result that is in {out}"
