"""What kind of log a path is: told by its content, never by its name."""

from __future__ import annotations

from pathlib import Path

from mavins.errors import LogFormatError
from mavins.logs.csv_table import find_table


def kind_of(log: Path) -> str:
    """The kind of a log; LogFormatError for a folder that is none."""
    if not log.is_dir():
        return "tlog"
    if find_table(log, "imu") is None:
        raise LogFormatError(f"{log} is no log: it holds no imu.csv")
    return "csv_folder"
