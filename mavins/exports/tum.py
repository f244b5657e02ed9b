"""The trajectory as evo and its kin read it: `seconds x y z qx qy qz qw`, in n, body to n."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from mavins.evaluation.result_folder import Result
from mavins.exports.places import attitude_in_n

FILES: Final = ("estimates.tum",)
NEEDS: Final = ()
_FORMAT: Final = "%.6f %.4f %.4f %.4f %.9f %.9f %.9f %.9f"


def write(result: Result, folder: Path) -> None:
    """Write estimates.tum; the seconds count on the vehicle's clock, as t_us does."""
    estimates = result.estimates
    q = attitude_in_n(result)
    rows = np.column_stack(
        [estimates.t_s, estimates.stack("p_n", "p_e", "p_d"), q[:, 1:], q[:, :1]]
    )
    rows = rows[np.isfinite(rows).all(axis=1)]
    with (folder / FILES[0]).open("w", encoding="ascii", newline="\n") as file:
        np.savetxt(file, rows, _FORMAT)
