"""A result folder as arrays: what `mavins replay` and `mavins serve` write, read back (docs/reference/results.md)."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins.config import load
from mavins.errors import LogFormatError
from mavins.estimates import Estimates, Innovations, Result, by_aiding
from mavins.evaluation.evidence import FILE, read_evidence
from mavins.logs.csv_table import read_rows, with_nan
from mavins.logs.truth import judge_of
from mavins.nav.layout import CORE, Layout
from mavins.results import BIAS_SIGMAS, EXTRA, INNOVATIONS, columns, width

_ROW: Final = np.dtype(
    [
        ("t_us", np.int64),
        ("stamp_us", np.int64),
        ("aiding", "S32"),
        ("source", "S64"),
        ("accepted", np.int8),
        ("reason", "S64"),
        ("nis", np.float64),
        ("innovation", np.float64, 3),
        ("sigma", np.float64, 3),
    ]
)
"""A line of innovations.csv."""


def read_result(folder: Path | str, filter_name: str | None = None) -> Result:
    """Read a result folder: that filter's, or the one that summary.json names. Raises LogFormatError."""
    folder = Path(folder)
    summary = _summary(folder / "summary.json")
    name = filter_name or str(summary.get("filter"))
    below = folder / name
    if not (below / "estimates.csv").exists():
        raise LogFormatError(f"{folder} is no result folder: there is no {name}/estimates.csv")
    estimates = read_estimates(below / "estimates.csv")
    evidence, bias_sigmas = read_evidence(below / FILE) or (None, np.empty((0, 6)))
    if len(bias_sigmas) == len(estimates):
        estimates.table[:, BIAS_SIGMAS] = bias_sigmas
    judge = None if evidence is None else judge_of(evidence.truth, evidence.reference)
    smoothed = below / "smoothed.csv"
    return Result(
        estimates.t_us,
        estimates.table,
        estimates.layout,
        load(below / "config.yaml"),
        read_innovations(below / "innovations.csv"),
        evidence,
        (estimates.against(judge) or None) if judge is not None and len(estimates) else None,
        read_estimates(smoothed) if smoothed.exists() else None,
        summary,
    )


def read_estimates(path: Path) -> Estimates:
    """estimates.csv or smoothed.csv, in the order of the file, without sigmas of the biases. Raises LogFormatError."""
    t_us, names, rows = read_rows(path, columns(Layout.of()), ",".join(EXTRA.values()).split(","))
    blocks = (block for block, further in EXTRA.items() if set(further.split(",")) <= set(names))
    layout = Layout.of((*CORE, *blocks))
    table = np.full((len(rows), width(layout)), np.nan)
    table[:, : BIAS_SIGMAS.start] = rows[:, [names.index(name) for name in columns(layout)]]
    table[:, :2] = np.radians(table[:, :2])
    return Estimates(t_us, table, layout)


def read_innovations(path: Path) -> dict[str, Innovations]:
    """innovations.csv by aiding, each in the order of the file. Raises LogFormatError."""
    try:
        head, _, body = path.read_bytes().partition(b"\n")
    except OSError as error:
        raise LogFormatError(f"cannot read {path}: {error.strerror}") from error
    if head.decode("latin-1").strip() != INNOVATIONS:
        raise LogFormatError(f"{path} is damaged: not the columns of innovations.csv")
    if not body.strip():
        return {}
    try:
        rows = np.loadtxt(
            io.BytesIO(with_nan(body)), dtype=_ROW, delimiter=",", comments=None, ndmin=1
        )
    except ValueError as error:
        raise LogFormatError(f"{path} is damaged: {error}") from error
    words = {name: rows[name].astype(np.str_) for name in ("aiding", "source", "reason")}
    words["reason"][words["reason"] == "nan"] = ""
    columns = {name: rows[name] for name in _ROW.names or ()}
    return by_aiding(columns | words | {"accepted": rows["accepted"] == 1})


def _summary(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LogFormatError(
            f"{path.parent} is no result folder: there is no summary.json"
        ) from error
    except (OSError, ValueError) as error:
        raise LogFormatError(f"cannot read {path}: {error}") from error
    if not isinstance(content, dict):
        raise LogFormatError(f"{path} is damaged: not a summary")
    return content
