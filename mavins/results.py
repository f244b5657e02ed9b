"""The result folder: estimates.csv and innovations.csv, written alike by a live service and by a replay.

A replay that smooths adds smoothed.csv, with the columns of estimates.csv. Both hold SI units and radians: p in n,
velocity and attitude in the local level frame.
"""

from __future__ import annotations

import json
import math
import tempfile
from array import array
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from mavins.errors import OutputError
from mavins.estimator.fusion import Event
from mavins.estimator.solution import (
    B_A,
    B_G,
    EULER,
    P_N,
    SD_EULER,
    SD_P,
    SD_V,
    V_L,
    WIDTH,
    describe,
)
from mavins.filters.base import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import BLOCKS, Layout, size_of
from mavins.status import finite
from mavins.table_text import csv_lines
from mavins.types import FloatArray, IntArray

ESTIMATES: Final = (
    "t_us,lat_deg,lon_deg,alt_m,p_n,p_e,p_d,v_n,v_e,v_d,roll,pitch,yaw,q_w,q_x,q_y,q_z,"
    "sd_p_n,sd_p_e,sd_p_d,sd_v_n,sd_v_e,sd_v_d,sd_roll,sd_pitch,sd_yaw,"
    "b_g_x,b_g_y,b_g_z,b_a_x,b_a_y,b_a_z"
)
EXTRA: Final = {
    "l_b": "l_b_x,l_b_y,l_b_z,sd_l_b_x,sd_l_b_y,sd_l_b_z",
    "tau": "tau,sd_tau",
    "b_baro": "b_baro,sd_b_baro",
    "b_m": "b_m_x,b_m_y,b_m_z,sd_b_m_x,sd_b_m_y,sd_b_m_z",
    "g_n": "g_n,g_e,sd_g_n,sd_g_e",
}
"""The columns that follow for each further block of states that is estimated."""
INNOVATIONS: Final = (
    "t_us,stamp_us,aiding,source,accepted,reason,nis,"
    "innovation_0,innovation_1,innovation_2,sigma_0,sigma_1,sigma_2"
)
SUMMARY: Final = "summary.json"
"""Written last: a folder that has it is whole."""
REPORT: Final = "report.html"
FILES: Final = (
    "estimates.csv",
    "innovations.csv",
    "smoothed.csv",
    "evidence.npz",
    "config.yaml",
)
"""What there may be in a filter's folder, exports aside."""
_DECIMALS: Final = np.array([10, 10, 4] + [6] * 6 + [9] * 7 + [6] * 6 + [9] * 9, dtype=np.int64)
"""Of each column after t_us: lat and lon in degrees to 10 um, metres and m/s to a millionth, angles to a nanoradian."""
_NUMBERS: Final = 10
"""Of a decision: t_us, stamp_us, its kind, nis, innovation (3), variance (3)."""
_LACK: Final = [[math.nan] * (3 - m) for m in range(4)]
BIAS_SIGMAS: Final = slice(-6, None)
"""Where a table has the sigmas of b_g and b_a, which estimates.csv leaves to evidence.npz."""
_LINES_HELD: Final = 256
_LINES_AT_ONCE: Final = 1 << 12
_ROWS_AT_ONCE: Final = 1 << 14
_DEGREES: Final = 180.0 / math.pi


_PLACES: Final = {
    "p_n": (P_N, SD_P),
    "v": (V_L, SD_V),
    "euler": (EULER, SD_EULER),
    "b_g": (B_G, slice(-6, -3)),
    "b_a": (B_A, slice(-3, None)),
}


def places(layout: Layout) -> dict[str, tuple[slice, slice]]:
    """Where a table has the values and the sigmas of a state."""
    found, begin = dict(_PLACES), WIDTH
    for name in _further(layout):
        n = size_of(name)
        found[name] = (slice(begin, begin + n), slice(begin + n, begin + 2 * n))
        begin += 2 * n
    return found


def width(layout: Layout) -> int:
    """How many columns a table has."""
    return WIDTH + sum(2 * size_of(name) for name in _further(layout)) + 6


def columns(layout: Layout) -> list[str]:
    """The columns of estimates.csv after t_us."""
    return ",".join([ESTIMATES, *(EXTRA[name] for name in _further(layout))]).split(",")[1:]


def table_of(block: RowBlock, frame: TangentFrame, layout: Layout) -> FloatArray:
    """A block's estimates as a table (N, 37 + k): described rows, the further states, then the biases' sigmas."""
    n = block.count
    rows = np.empty((n, WIDTH))
    describe(block.x[:n], block.P[:n], frame.r0_e, frame.C_ne, rows)
    sigmas = layout.sigmas(block.P[:n])
    parts = [rows]
    for name in _further(layout):
        at = BLOCKS[name]
        parts += [block.x[:n, at.start + 1 : at.stop + 1], sigmas[:, at]]
    return np.hstack([*parts, sigmas[:, BLOCKS["b_g"]], sigmas[:, BLOCKS["b_a"]]])


def _further(layout: Layout) -> list[str]:
    return [name for name in EXTRA if name in layout.blocks]


def as_shown(table: FloatArray) -> tuple[FloatArray, IntArray]:
    """What estimates.csv shows of a table (N, 31 + k), in degrees where it does, and with how many decimals."""
    shown = table[:, : BIAS_SIGMAS.start].copy()
    shown[:, :2] *= _DEGREES
    return shown, np.append(_DECIMALS, np.full(shown.shape[1] - len(_DECIMALS), 6))


class EstimatesFile:
    """A CSV file of estimates, over the states of a layout."""

    def __init__(self, path: Path, layout: Layout) -> None:
        self.file = _open(path, ",".join(["t_us", *columns(layout)]))

    def write(self, t_us: IntArray, table: FloatArray) -> None:
        """Write the rows of a table."""
        for k in range(0, len(t_us), _ROWS_AT_ONCE):
            part = slice(k, k + _ROWS_AT_ONCE)
            text = csv_lines(t_us[part], *as_shown(table[part])).decode("ascii")
            with _or_say_so(self.file):
                self.file.write(text)

    def close(self) -> None:
        """Write what is buffered and close the file."""
        with _or_say_so(self.file):
            self.file.close()


class Decisions:
    """Final decisions in the order in which they were made, in few bytes."""

    def __init__(self) -> None:
        self._numbers = array("d")
        self._kinds: dict[tuple[str, str, str, int], int] = {}

    def __len__(self) -> int:
        return len(self._numbers) // _NUMBERS

    def keep(self, event: Event) -> None:
        """Keep a decision."""
        m, r = event.measurement, event.innovation.tolist()
        kind = (m.aiding, m.source, event.reason, len(r))
        lack, variances = _LACK[len(r)], event.S.diagonal().tolist()
        head = (m.t_us, m.stamp_us, self._kinds.setdefault(kind, len(self._kinds)), event.nis)
        self._numbers.extend((*head, *r, *lack, *variances, *lack))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All of them by the names of `Innovations` (mavins/estimates.py), and their aiding; nan for lacking rows."""
        n, which = self._table()
        words = [kind[:3] for kind in self._kinds]
        aiding, source, reason = np.array(words, dtype=np.str_).reshape(-1, 3)[which].T
        return {
            "t_us": n[:, 0].astype(np.int64),
            "stamp_us": n[:, 1].astype(np.int64),
            "aiding": aiding,
            "source": source,
            "accepted": reason == "",
            "reason": reason,
            "nis": n[:, 3],
            "innovation": n[:, 4:7],
            "sigma": n[:, 7:10],
        }

    def lines(self) -> Iterator[str]:
        """The lines of innovations.csv, some at a time; what is not known stays empty."""
        n, which = self._table()
        for k in range(0, len(n), _LINES_AT_ONCE):
            part = slice(k, k + _LINES_AT_ONCE)
            lines = np.empty(len(n[part]), dtype=np.object_)
            for number, kind in enumerate(self._kinds):
                of_kind = which[part] == number
                line, m = _line_of(*kind), kind[-1]
                rows = n[part][of_kind][:, [0, 1, 3, *range(4, 4 + m), *range(7, 7 + m)]].tolist()
                lines[of_kind] = [line % tuple(row) for row in rows]
            yield "".join(lines).replace("nan", "")

    def _table(self) -> tuple[FloatArray, IntArray]:
        """The numbers (N, 10), with sigmas for variances, and the kinds (N,)."""
        n = np.array(self._numbers).reshape(-1, _NUMBERS)
        n[:, 7:] = np.sqrt(np.where(n[:, 7:] >= 0.0, n[:, 7:], np.nan))
        return n, n[:, 2].astype(np.int64)


def _line_of(aiding: str, source: str, reason: str, rows: int) -> str:
    """How a line of innovations.csv is made of t_us, stamp_us, nis and so many innovations and sigmas."""
    words = f"{aiding},{source},{not reason:d},{reason}".replace("%", "%%")
    return f"%d,%d,{words},%.9g" + 2 * (",%.9g" * rows + "," * (3 - rows)) + "\n"


class ResultWriter:
    """Writes rows and decisions as they come."""

    def __init__(self, folder: Path, layout: Layout) -> None:
        self._layout = layout
        self._estimates = EstimatesFile(folder / "estimates.csv", layout)
        self._innovations = _open(folder / "innovations.csv", INNOVATIONS)
        self._decisions = Decisions()
        self.rows = 0

    def write_rows(self, block: RowBlock, frame: TangentFrame) -> None:
        """Write the estimates of a block."""
        self.write_table(block.t_us[: block.count], table_of(block, frame, self._layout))

    def write_table(self, t_us: IntArray, table: FloatArray) -> None:
        """Write the rows (N, 37 + k) of `table_of`."""
        self.rows += len(t_us)
        self._estimates.write(t_us, table)

    def write_decision(self, event: Event) -> None:
        """Write the final decision on a measurement."""
        self._decisions.keep(event)
        if len(self._decisions) >= _LINES_HELD:
            self._write_held()

    def write_decisions(self, decisions: Decisions) -> None:
        """Write all of them."""
        for lines in decisions.lines():
            with _or_say_so(self._innovations):
                self._innovations.write(lines)

    def _write_held(self) -> None:
        held, self._decisions = self._decisions, Decisions()
        self.write_decisions(held)

    def flush(self) -> None:
        """Hand what is buffered to the operating system."""
        self._write_held()
        for file in (self._estimates.file, self._innovations):
            with _or_say_so(file):
                file.flush()

    def close(self) -> None:
        """Write what is buffered and close the files."""
        self._write_held()
        for file in (self._estimates.file, self._innovations):
            with _or_say_so(file):
                file.close()

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


@contextmanager
def _or_say_so(file: IO[str]) -> Iterator[None]:
    """Turn a failure to write (a full disk) into an OutputError that names the file."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write {file.name}: {error.strerror}") from error


def _open(path: Path, header: str) -> IO[str]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w", encoding="ascii", newline="\n", buffering=1 << 16)
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error.strerror}; choose another --out folder"
        ) from error
    file.write(header + "\n")
    return file


def check_folder(folder: Path) -> None:
    """Make the folder; OutputError where no file can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"cannot write into {folder}: {error.strerror}; choose another folder"
        ) from error


def write_text(path: Path, text: str) -> None:
    """Write a small file whole: aside, then renamed into place."""
    aside = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside.write_text(text, encoding="utf-8")
        aside.replace(path)
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error.strerror}; choose another --out folder"
        ) from error
    finally:
        with suppress(OSError):
            aside.unlink(missing_ok=True)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a dictionary as JSON; what is not a finite number becomes null."""
    write_text(path, json.dumps(finite(content), indent=2) + "\n")
