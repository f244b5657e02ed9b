"""Rows of numbers and words as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from typing import Any


def cell(value: Any) -> Any:
    """A value as it is written: six digits of a number, nothing for what is not known."""
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else ""
    return "" if value is None else value


def csv_text(rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows of the same keys as the text of a CSV file."""
    table = list(rows)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()
