"""What kind of log a path is: told by its content, never by its name."""

from __future__ import annotations

from pathlib import Path


def kind_of(log: Path) -> str:
    """The kind of a log."""
    return "csv_folder" if log.is_dir() else "tlog"
