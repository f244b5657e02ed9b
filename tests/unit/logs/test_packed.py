"""What packs a file: told by content, read as a stream, salvaged where it is damaged."""

from __future__ import annotations

import gzip
import lzma
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from mavins.errors import LogFormatError
from mavins.logs.packed import fault_of, open_packed

PLAIN = bytes(range(256)) * 3000 + b"the end"


def zstd(data: bytes) -> bytes:
    zstandard = pytest.importorskip("zstandard", reason="needs the extra logs")
    return bytes(zstandard.compress(data))


PACKERS = [gzip.compress, lzma.compress, zstd]


@pytest.fixture(params=PACKERS, ids=["gz", "xz", "zst"])
def pack(request: pytest.FixtureRequest) -> Callable[[bytes], bytes]:
    return request.param  # type: ignore[no-any-return]


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_a_plain_file_can_be_sought_in(tmp_path: Path) -> None:
    with open_packed(written(tmp_path / "log.gz", PLAIN)) as stream:
        assert stream.read() == PLAIN
        stream.seek(-7, 2)
        assert stream.read() == b"the end"
        assert fault_of(stream) == ""


def test_whatever_its_name(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    with open_packed(written(tmp_path / "log.bin", pack(PLAIN))) as stream:
        assert stream.read(10) == PLAIN[:10]
        assert stream.read() == PLAIN[10:]
        assert fault_of(stream) == ""


def test_several_in_a_row_and_padding(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    data = pack(PLAIN) + pack(b"more") + bytes(8)
    with open_packed(written(tmp_path / "log", data)) as stream:
        assert stream.read() == PLAIN + b"more"
        assert fault_of(stream) == ""


def test_what_is_cut_off_is_read_up_to_the_cut(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    noise = Random(1).randbytes(1_000_000)
    packed = pack(noise)
    with open_packed(written(tmp_path / "log", packed[: len(packed) * 3 // 4])) as stream:
        read = stream.read()
        assert read
        assert noise.startswith(read)
        assert len(read) < len(noise)
        assert fault_of(stream) == "cut off"


def test_damage_within_is_the_end(tmp_path: Path) -> None:
    packed = bytearray(lzma.compress(Random(1).randbytes(300_000)))
    packed[len(packed) // 2] ^= 0x10
    with open_packed(written(tmp_path / "log", bytes(packed))) as stream:
        stream.read()
        assert fault_of(stream)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "is empty"),
        (gzip.compress(b"", mtime=0), "is empty"),
        (lzma.compress(b""), "is empty"),
        (b"\x1f\x8b" + bytes(10), "is damaged"),
        (b"\xfd7zXZ\x00" + bytes(20), "is damaged"),
        (gzip.compress(PLAIN, mtime=0)[:12], "is damaged: cut off"),
    ],
)
def test_nothing_to_read_is_one_line(tmp_path: Path, data: bytes, told: str) -> None:
    with pytest.raises(LogFormatError, match=told) as caught:
        open_packed(written(tmp_path / "log", data))
    assert "\n" not in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="cannot read"):
        open_packed(tmp_path / "none")
    with pytest.raises(LogFormatError, match="cannot read"):
        open_packed(tmp_path)
