"""The trajectory as evo and its kin read it: `seconds x y z qx qy qz qw`, in n, body to n."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from mavins.estimates import Result
from mavins.exports.places import attitude_in_n
from mavins.table_text import csv_lines

FILES: Final = ("estimates.tum",)
NEEDS: Final = ()
_DECIMALS: Final = np.array([6, 4, 4, 4, 9, 9, 9, 9])


def write(result: Result, folder: Path) -> None:
    """Write estimates.tum; the seconds count on the vehicle's clock, as t_us does."""
    q = attitude_in_n(result)
    rows = np.column_stack([result.seconds, result.p_n, q[:, 1:], q[:, :1]])
    rows = rows[np.isfinite(rows).all(axis=1)]
    # the quick writer begins each line with an integer, which is not wanted here
    lines = b"\n" + csv_lines(np.zeros(len(rows), dtype=np.int64), rows, _DECIMALS)
    text = lines.replace(b"\n0,", b"\n").replace(b",", b" ")
    (folder / FILES[0]).write_bytes(text.removeprefix(b"\n"))
