"""What kind of log a path is: told by its content, never by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mavins.errors import LogFormatError
from mavins.logs.csv_table import find_table
from mavins.logs.packed import open_packed

_MAGIC: Final = {
    b"ULog\x01\x12\x35": "ulog",
    b"\xa3\x95\x80": "dataflash",
    b"FMT,": "dataflash",
    b"FMT ,": "dataflash",
}
_OTHERS: Final = {
    b"PK\x03\x04": "a zip archive; unpack it first",
    b"\xd4\xc3\xb2\xa1": "a packet capture; mavins reads MAVLink from logs and links",
    b"#ROSBAG": "a ROS bag; mavins does not read those",
    b"\x89MCAP0\r\n": "an MCAP file; mavins does not read those",
}
"""How files begin that someone may well try."""
_HEAD: Final = 512


def kind_of(log: Path) -> str:
    """The kind of a log; LogFormatError for what cannot be read, or is known to be something else."""
    if log.is_dir():
        return _kind_of_folder(log)
    with open_packed(log) as stream:
        head = stream.read(_HEAD)
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    for magic, what in _OTHERS.items():
        if head.startswith(magic):
            raise LogFormatError(f"{log} is {what}")
    return "tlog"


def _kind_of_folder(folder: Path) -> str:
    if find_table(folder, "imu") is not None:
        return "csv_folder"
    return "csv_folder"
