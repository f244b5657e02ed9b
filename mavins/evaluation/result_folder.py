"""A result folder as arrays: what `mavins replay` and `mavins serve` write, read back (docs/reference/results.md)."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavins.config import Config, load
from mavins.errors import LogFormatError
from mavins.evaluation.errors import Errors, errors_against
from mavins.evaluation.evidence import FILE, Evidence, read_evidence
from mavins.logs.csv_table import read_table, with_nan
from mavins.logs.truth import Truth
from mavins.results import BIAS_SIGMA_NAMES, ESTIMATES, EXTRA, INNOVATIONS
from mavins.types import FloatArray, IntArray

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


@dataclass(frozen=True, slots=True)
class Estimates:
    """estimates.csv: N rows, `t_us` (N,) and the other columns (N,) by their names, in the file's units.

    Where evidence was kept the sigmas of the biases are among them.
    """

    t_us: IntArray
    columns: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(self.t_us)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def stack(self, *names: str) -> FloatArray:
        """Columns side by side (N, m)."""
        return np.column_stack([self.columns[name] for name in names])

    @property
    def t_s(self) -> FloatArray:
        """Seconds (N,) on the vehicle's clock."""
        return np.multiply(self.t_us, 1e-6, dtype=np.float64)

    @property
    def lla(self) -> FloatArray:
        """Latitude and longitude in rad, altitude in m above mean sea level (N, 3)."""
        lla = self.stack("lat_deg", "lon_deg", "alt_m")
        lla[:, :2] = np.radians(lla[:, :2])
        return lla

    @property
    def v_l(self) -> FloatArray:
        """Velocity (N, 3) m/s, local level."""
        return self.stack("v_n", "v_e", "v_d")

    @property
    def euler(self) -> FloatArray:
        """Roll, pitch, yaw (N, 3) rad."""
        return self.stack("roll", "pitch", "yaw")

    @property
    def sd_p(self) -> FloatArray:
        """1-sigma of the position in n (N, 3) m."""
        return self.stack("sd_p_n", "sd_p_e", "sd_p_d")

    @property
    def sd_v(self) -> FloatArray:
        """1-sigma of the velocity (N, 3) m/s."""
        return self.stack("sd_v_n", "sd_v_e", "sd_v_d")

    @property
    def sd_euler(self) -> FloatArray:
        """1-sigma of roll, pitch, yaw (N, 3) rad."""
        return self.stack("sd_roll", "sd_pitch", "sd_yaw")


@dataclass(frozen=True, slots=True)
class Innovations:
    """One aiding's decisions, M of them with m rows each.

    `t_us` (M,) is when the measurement was valid, `stamp_us` (M,) its stamp; `innovation` and `sigma` (M, m), `nis`
    (M,), with nan where there was none; `accepted` (M,); `reason` (M,) says why not.
    """

    aiding: str
    t_us: IntArray
    stamp_us: IntArray
    source: NDArray[np.str_]
    accepted: NDArray[np.bool_]
    reason: NDArray[np.str_]
    nis: FloatArray
    innovation: FloatArray
    sigma: FloatArray

    def __len__(self) -> int:
        return len(self.t_us)

    def select(self, rows: NDArray[Any]) -> Innovations:
        """The decisions with these numbers, or where this is true."""
        return Innovations(
            self.aiding,
            self.t_us[rows],
            self.stamp_us[rows],
            self.source[rows],
            self.accepted[rows],
            self.reason[rows],
            self.nis[rows],
            self.innovation[rows],
            self.sigma[rows],
        )


@dataclass(frozen=True, slots=True)
class Result:
    """One filter's result. `innovations` by aiding; `evidence` is None where none was kept, as by a live service.

    `errors` are estimates minus `judge` at the instants that it covers; None where there is none.
    """

    folder: Path
    filter: str
    summary: dict[str, Any]
    config: Config
    estimates: Estimates
    innovations: dict[str, Innovations]
    evidence: Evidence | None
    errors: Errors | None

    @property
    def judge(self) -> Truth | None:
        """What the estimates are measured against: the truth, or for want of one the log's own filter."""
        return _judge(self.evidence)

    @property
    def is_true(self) -> bool:
        """True where `judge` is a truth."""
        return self.evidence is not None and self.judge is self.evidence.truth

    def at(self, t_us: IntArray) -> IntArray:
        """Which row of `estimates` is the last one before or at each of these instants."""
        k: IntArray = np.maximum(np.searchsorted(self.estimates.t_us, t_us, side="right") - 1, 0)
        return k


def read_result(folder: Path, filter_name: str | None = None) -> Result:
    """Read a result folder: that filter's, or the one that summary.json names. Raises LogFormatError."""
    summary = _summary(folder / "summary.json")
    name = filter_name or str(summary.get("filter"))
    below = folder / name
    if not (below / "estimates.csv").exists():
        raise LogFormatError(f"{folder} is no result folder: there is no {name}/estimates.csv")
    _, *core = ESTIMATES.split(",")
    further = [column for columns in EXTRA.values() for column in columns.split(",")]
    table, evidence = (
        read_table(below / "estimates.csv", core, further),
        read_evidence(below / FILE),
    )
    columns = dict(table.columns)
    if evidence is not None and len(evidence.bias_sigmas) == len(table.t_us):
        columns |= dict(zip(BIAS_SIGMA_NAMES, evidence.bias_sigmas.T, strict=True))
    estimates = Estimates(table.t_us, columns)
    return Result(
        folder,
        name,
        summary,
        load(below / "config.yaml"),
        estimates,
        read_innovations(below / "innovations.csv"),
        evidence,
        errors_of(estimates, _judge(evidence)),
    )


def _judge(evidence: Evidence | None) -> Truth | None:
    judges = () if evidence is None else (evidence.truth, evidence.reference)
    return next((judge for judge in judges if judge is not None and len(judge) > 1), None)


def errors_of(e: Estimates, judge: Truth | None) -> Errors | None:
    """Estimate minus truth at the instants that it covers; None where there is none."""
    if judge is None or not len(e):
        return None
    errors = errors_against(e.t_us, e.lla, e.v_l, e.euler, judge.columns())
    return errors if len(errors.t_us) else None


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
    names, first, which = np.unique(rows["aiding"], return_index=True, return_inverse=True)
    return {
        names[k].decode("latin-1"): _innovations(rows[which == k])
        for k in np.argsort(first).tolist()
    }


def _innovations(rows: NDArray[Any]) -> Innovations:
    values = rows["innovation"]
    width = max(1, int(np.isfinite(values).any(axis=0).sum()))
    reason = np.where(rows["reason"] == b"nan", b"", rows["reason"])
    return Innovations(
        rows["aiding"][0].decode("latin-1"),
        rows["t_us"].copy(),
        rows["stamp_us"].copy(),
        rows["source"].astype(np.str_),
        rows["accepted"] == 1,
        reason.astype(np.str_),
        rows["nis"].copy(),
        values[:, :width].copy(),
        rows["sigma"][:, :width].copy(),
    )


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
