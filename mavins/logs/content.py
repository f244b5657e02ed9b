"""What kind of log a path is: told by its content, never by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mavins.errors import LogFormatError
from mavins.logs.csv_table import find_table
from mavins.logs.euroc import root_of
from mavins.logs.kf_gins import role_of
from mavins.logs.packed import open_packed
from mavins.logs.ulog_file import MAGIC

_KINDS: Final = {
    MAGIC: "ulog",
    b"\xa3\x95\x80": "dataflash",
    b"FMT,": "dataflash",
}
_OTHERS: Final = {
    b"PK\x03\x04": "a zip archive; unpack it first",
    b"ULogEnc": "an encrypted .ulge; decrypt it first",
    b"#ROSBAG": "a ROS bag, which is not read here",
    b"SQLite format 3": "a ROS 2 bag, which is not read here",
    b"\x89MCAP0\r\n": "an MCAP file, which is not read here",
}
"""How files begin that someone may well try."""


def kind_of(log: Path) -> str:
    """The kind of a log; LogFormatError for what cannot be read, or is known to be something else."""
    if log.is_dir():
        return _kind_of_folder(log)
    with open_packed(log) as stream:
        head = stream.read(16)
    for magic, kind in _KINDS.items():
        if head.startswith(magic):
            return kind
    for magic, what in _OTHERS.items():
        if head.startswith(magic):
            raise LogFormatError(f"{log} is {what}")
    return "tlog" if role_of(log) is None else "kf_gins"


def _kind_of_folder(folder: Path) -> str:
    if find_table(folder, "imu") is not None:
        return "csv_folder"
    if root_of(folder) is not None:
        return "euroc"
    if any(role_of(file) == "imu" for file in sorted(folder.iterdir()) if file.is_file()):
        return "kf_gins"
    raise LogFormatError(
        f"{folder} is no log: it holds no imu.csv, no imu0/data.csv, and no text file of IMU increments"
    )
