"""An archive: a folder of logs of any kind, each replayed into a result folder of its own, and one table over all.

What is finished is not done again: a log is finished when its result folder has a whole summary.json, and beside it
`replayed.json` names the same log, configuration and options. A log that cannot be replayed takes no other along.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mavins import __version__
from mavins.campaign.tables import cell, csv_text
from mavins.campaign.workers import LOST, Workers, ready, spread
from mavins.config import Config, to_yaml
from mavins.errors import LogFormatError, MavinsError, NotALogError, OutputError
from mavins.logs.content import kind_of
from mavins.replay import ReplayOptions, replay
from mavins.results import write_json, write_text

DONE, FAILED, NO_LOG = "done", "failed", "no log"
MARK: Final = "replayed.json"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LogJob:
    """One log of an archive, called `name` in it, into the result folder `out`."""

    name: str
    log: Path
    out: Path
    config: Config
    options: ReplayOptions


@dataclass(frozen=True, slots=True)
class Replayed:
    """What came of a log: `status` done, failed or no log, and why; `summary` as summary.json has it."""

    name: str
    status: str
    reason: str = ""
    summary: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def is_archive(path: Path) -> bool:
    """True for a folder that is not itself a log."""
    if not path.is_dir():
        return False
    try:
        kind_of(path)
    except LogFormatError:
        return True
    return False


def logs_in(archive: Path, leave_out: Path) -> Iterator[Path]:
    """Files and folders that may be logs, by name; what begins with a dot and a folder of results are left out."""
    for path in sorted(archive.iterdir()):
        if path.name.startswith(".") or path.resolve() == leave_out.resolve():
            continue
        if is_archive(path):
            if not (path / "summary.json").exists():
                yield from logs_in(path, leave_out)
        else:
            yield path


def jobs_of(archive: Path, out: Path, config: Config, options: ReplayOptions) -> list[LogJob]:
    """The logs of an archive; LogFormatError where there is none."""
    if out.resolve() == archive.resolve():
        raise OutputError(f"--out {out} is the archive itself; choose another folder")
    jobs = []
    for log in logs_in(archive, out):
        name = log.relative_to(archive).as_posix()
        jobs.append(LogJob(name, log, out / name, config, options))
    if not jobs:
        raise LogFormatError(f"{archive} is no log, and holds none")
    return jobs


def replay_one(job: LogJob) -> Replayed:
    """Replay a log; whatever goes wrong with it is what came of it."""
    try:
        ready(job.config.filter)
        (job.out / MARK).unlink(missing_ok=True)
        summary = replay(job.log, job.out, job.config, job.options)
        write_json(job.out / MARK, _mark(job))
        return Replayed(job.name, DONE, summary=_as_written(job.out) or summary)
    except NotALogError as error:
        return Replayed(job.name, NO_LOG, str(error))
    except (MavinsError, OSError) as error:
        return Replayed(job.name, FAILED, str(error))
    except ModuleNotFoundError as error:
        hint = "install it with: pip install 'mavins[logs]'"
        return Replayed(job.name, FAILED, f"the module '{error.name}' is not installed; {hint}")
    except Exception as error:
        # a mistake of ours in one log is no reason to lose the others: it is told with its name
        _LOG.exception("%s", job.name)
        return Replayed(job.name, FAILED, f"{type(error).__name__}: {error}")


def replay_archive(
    jobs: Sequence[LogJob], workers: Workers, progress: Callable[[float], None] = lambda _: None
) -> list[Replayed]:
    """All logs in their order: those that are finished as they are, the others replayed."""
    found = {k: done for k, job in enumerate(jobs) if (done := finished(job)) is not None}
    left = [k for k in range(len(jobs)) if k not in found]
    if left:
        ready(jobs[0].config.filter)
    with closing(spread(replay_one, [jobs[k] for k in left], workers)) as outcomes:
        for place, outcome in outcomes:
            k = left[place]
            found[k] = outcome or Replayed(jobs[k].name, FAILED, LOST)
            _LOG.info("%s: %s %s", found[k].name, found[k].status, found[k].reason)
            progress(len(found) / len(jobs))
    return [found[k] for k in sorted(found)]


def finished(job: LogJob) -> Replayed | None:
    """What an earlier replay of the same log with the same settings left, if it is whole."""
    if _json(job.out / MARK) != _mark(job):
        return None
    summary = _as_written(job.out)
    return None if summary is None else Replayed(job.name, DONE, summary=summary)


def _mark(job: LogJob) -> dict[str, Any]:
    """What a result depends on."""
    stat = job.log.stat()
    size = [stat.st_size, stat.st_mtime_ns]
    if job.log.is_dir():
        inside = [file.stat() for file in sorted(job.log.rglob("*")) if file.is_file()]
        size = [sum(s.st_size for s in inside), max(s.st_mtime_ns for s in inside)]
    mark = {
        "mavins": __version__,
        "log_bytes_and_mtime": size,
        "options": dataclasses.asdict(job.options),
        "config": to_yaml(job.config, commented=False).splitlines(),
    }
    # as it is read back: of tuples JSON makes lists
    read_back: dict[str, Any] = json.loads(json.dumps(mark))
    return read_back


def _as_written(out: Path) -> dict[str, Any] | None:
    summary = _json(out / "summary.json")
    return summary if isinstance(summary, dict) and "rows" in summary else None


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def row_of(one: Replayed) -> dict[str, Any]:
    """A line of the table: what came of a log, in numbers that do not depend on who replayed it."""
    s = one.summary
    judged = s.get("truth") or s.get("reference") or {}
    rms, aiding = judged.get("rms", {}), s.get("aiding", {})
    pos, vel = (rms.get(key, [None] * 3) for key in ("pos_m", "vel_m_s"))
    row: dict[str, Any] = {"log": one.name, "status": one.status}
    row |= {key: s.get(key) for key in ("filter", "health", "log_s", "rows", "resets")}
    row |= {
        "fused": sum(a["accepted"] for a in aiding.values()) if s else None,
        "refused": sum(sum(a["rejected"].values()) for a in aiding.values()) if s else None,
        "judged_by": judged.get("source"),
        "rms_horizontal_m": _length(pos[:2]),
        "rms_vertical_m": _length(pos[2:]),
        "rms_speed_m_s": _length(vel),
    }
    angles = rms.get("att_deg", [None] * 3)
    row |= dict(zip(("rms_roll_deg", "rms_pitch_deg", "rms_yaw_deg"), angles, strict=True))
    return row | {"reason": one.reason or s.get("reason")}


def _length(parts: Sequence[float | None]) -> float | None:
    known = [part for part in parts if part is not None]
    return math.hypot(*known) if len(known) == len(parts) else None


def write_archive(out: Path, archive: Path, replayed: Sequence[Replayed]) -> None:
    """Write the table as archive.csv and, with the aidings of each log, as archive.json."""
    rows = [row_of(one) for one in replayed]
    write_text(out / "archive.csv", csv_text({k: cell(v) for k, v in r.items()} for r in rows))
    logs = [
        row | {"aiding": one.summary.get("aiding", {})}
        for row, one in zip(rows, replayed, strict=True)
    ]
    write_json(out / "archive.json", {"mavins": __version__, "archive": str(archive), "logs": logs})


def table_lines(replayed: Sequence[Replayed]) -> Iterator[str]:
    """The table for people; a log that is not done has its reason."""
    wide = max(3, *(len(one.name) for one in replayed))
    yield (
        f"{'log':<{wide}}  {'s':>6}  {'health':<14}{'refused':>8}{'horizontal m':>14}"
        f"{'vertical m':>12}{'yaw deg':>9}  against"
    )
    for one in replayed:
        row = row_of(one)
        if one.status != DONE:
            yield f"{one.name:<{wide}}  {one.status}: {' '.join(one.reason.split())}"
            continue
        shares = row["fused"] + row["refused"]
        refused = f"{100 * row['refused'] / shares:.1f} %" if shares else "-"
        yield (
            f"{one.name:<{wide}}  {row['log_s']:>6.0f}  {row['health']:<14}{refused:>8}"
            f"{_shown(row['rms_horizontal_m']):>14}{_shown(row['rms_vertical_m']):>12}"
            f"{_shown(row['rms_yaw_deg']):>9}  {row['judged_by'] or '-'}"
        )


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
