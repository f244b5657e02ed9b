"""What kind of log a path is: its content decides, whatever it is called and packed in."""

from __future__ import annotations

import gzip
import lzma
from collections.abc import Callable
from pathlib import Path

import pytest

from mavins.errors import LogFormatError
from mavins.logs.content import kind_of

NOTHING = bytes(range(1, 200))


def as_it_is(data: bytes) -> bytes:
    return data


@pytest.mark.parametrize("pack", [as_it_is, gzip.compress, lzma.compress])
@pytest.mark.parametrize(
    ("head", "kind"),
    [
        (b"ULog\x01\x12\x35\x01", "ulog"),
        (b"\xa3\x95\x80", "dataflash"),
        (b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", "dataflash"),
        (b"\x00\x05\x9a", "tlog"),
    ],
)
def test_files(tmp_path: Path, head: bytes, kind: str, pack: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(pack(head + NOTHING))
    assert kind_of(path) == kind


def test_a_folder_of_csv(tmp_path: Path) -> None:
    (tmp_path / "imu.csv.xz").write_bytes(lzma.compress(b"t_us\n"))
    assert kind_of(tmp_path) == "csv_folder"


@pytest.mark.parametrize(
    ("head", "told"), [(b"PK\x03\x04", "a zip archive"), (b"#ROSBAG V2.0", "a ROS bag")]
)
def test_what_is_known_to_be_something_else(tmp_path: Path, head: bytes, told: str) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(head + NOTHING)
    with pytest.raises(LogFormatError, match=told):
        kind_of(path)


def test_a_folder_of_anything(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(LogFormatError, match="is no log"):
        kind_of(tmp_path)
