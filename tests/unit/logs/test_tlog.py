"""Telemetry logs: what is written is read back, also from .gz and .xz, and what is none says so in
one line.
"""

from __future__ import annotations

import gzip
import io
import lzma
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavutil

from mavins.errors import LogFormatError, OutputError
from mavins.logs.tlog import Tlog, TlogWriter, read_tlog
from mavins.mavlink.codec import frame, heartbeat, highres_imu, scan_tlog, system_time
from mavins.types import ImuSample

T0 = 1_750_000_000_000_000
SAMPLE = ImuSample(1_000_000, np.array([0.0, 0.0, -9.8]), np.zeros(3))


def write(path: Path, n: int = 10) -> list[bytes]:
    packets = [frame(system_time(0, 1000 * k), 1, 1, k) for k in range(n)]
    with TlogWriter(path) as log:
        for k, packet in enumerate(packets):
            log.write(T0 + 4000 * k, packet)
    return packets


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    packets = write(path)
    frames = read_tlog(path)
    assert [frames.packet(i) for i in range(len(frames))] == packets
    assert frames.t_us.tolist() == [T0 + 4000 * k for k in range(10)]
    assert not frames.damage


def test_pymavlink_reads_it_too(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    write(path)
    log = mavutil.mavlink_connection(str(path))
    first = log.recv_match(type="SYSTEM_TIME")
    assert first.time_boot_ms == 0
    assert first._timestamp == pytest.approx(T0 * 1e-6)
    log.close()


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_compressed_logs_are_told_by_content(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    plain = tmp_path / "flight.tlog"
    write(plain, 3000)
    packed = tmp_path / "flight.anything"
    packed.write_bytes(pack(plain.read_bytes()))
    assert len(read_tlog(packed)) == 3000
    # one that was cut off gives all up to the cut
    packed.write_bytes(packed.read_bytes()[:-2000])
    assert 0 < len(read_tlog(packed)) < 3000


def test_an_open_file_is_flushed_not_closed() -> None:
    stream = io.BytesIO()
    log = TlogWriter(stream)
    log.write(7, frame(heartbeat(2, 3), 1, 1, 0))
    assert stream.getvalue() == b""
    log.flush()
    assert stream.getvalue()[:8] == (7).to_bytes(8, "big")
    log.close()
    log.close()
    assert not stream.closed


def test_a_file_on_its_way_holds_whole_records_only(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    packet = frame(heartbeat(2, 3), 1, 1, 0)
    log = TlogWriter(path)
    for k in range(10_000):
        log.write(T0 + k, packet)
        if k % 1000 == 0:
            assert path.stat().st_size % (8 + len(packet)) == 0
    log.close()
    assert len(read_tlog(path)) == 10_000


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        TlogWriter(tmp_path / "no" / "such" / "folder.tlog")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (gzip.compress(b"", mtime=0), "is empty"),
        (b"time,lat,lon\n1,2,3\n" * 100, "not a MAVLink .tlog"),
        (bytes(10_000), "not a MAVLink .tlog"),
        (b"ULog\x01\x12\x35" + bytes(100), ".ulg"),
        (b"\xa3\x95\x80" + bytes(100), "dataflash"),
        (b"PK\x03\x04" + bytes(100), "zip"),
        (b"\x1f\x8b" + bytes(100), "damaged"),
        (b"\xfd7zXZ\x00" + bytes(100), "damaged"),
    ],
)
def test_what_is_no_log_says_so_in_one_line(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "thing"
    path.write_bytes(content)
    with pytest.raises(LogFormatError) as caught:
        read_tlog(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_log_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="No such file"):
        read_tlog(tmp_path / "missing.tlog")
    with pytest.raises(LogFormatError, match="directory"):
        read_tlog(tmp_path)


def damaged(rng: random.Random) -> bytes:
    """A log whose records are whole, cut, flipped, foreign or without their stamps."""
    data = bytearray()
    for k in range(rng.randint(1, 60)):
        packet = rng.choice(
            [
                frame(heartbeat(2, 3), 1, 1, k),
                frame(highres_imu(SAMPLE), 1, 1, k),
                b"\xfd\x03\x00\x00\x00\x01\x01\xee\xee\xee" + rng.randbytes(5),
            ]
        )
        record = (T0 + k).to_bytes(8, "big") + packet
        match rng.randrange(8):
            case 0:
                record = record[: rng.randrange(len(record))]
            case 1:
                at = rng.randrange(len(record))
                record = (
                    record[:at] + bytes([record[at] ^ 1 << rng.randrange(8)]) + record[at + 1 :]
                )
            case 2:
                record = record[rng.randrange(9) :]
            case 3:
                record += rng.randbytes(rng.randrange(300))
        data += record
    return bytes(data)


@given(st.integers(0, 2**32), st.integers(300, 4000))
@settings(max_examples=200, deadline=None)
def test_a_log_in_blocks_is_the_log(seed: int, block_size: int) -> None:
    data = T0.to_bytes(8, "big") + frame(heartbeat(2, 3), 1, 1, 0) + damaged(random.Random(seed))
    whole = scan_tlog(data)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.tlog"
        path.write_bytes(data)
        log = Tlog(path, block_size, keep=0)
        try:
            blocks = list(log)
        except LogFormatError:
            assert whole.damage.skipped_bytes > 0.9 * len(data)
            return
        again = list(log)
    for frames in (blocks, again):
        packets = [f.packet(i) for f in frames for i in range(len(f))]
        assert packets == [whole.packet(i) for i in range(len(whole))]
        stamps = [t for f in frames for t in f.t_us.tolist()]
        assert stamps == whole.t_us.tolist()
        for name in ("bad_crc", "unknown", "skipped_bytes", "truncated"):
            total = sum(getattr(f.damage, name) for f in frames)
            assert total == getattr(whole.damage, name), name


def test_a_small_log_is_read_once(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    with TlogWriter(path) as log:
        for k in range(100):
            log.write(T0 + k, frame(heartbeat(2, 3), 1, 1, k % 256))
    blocks = Tlog(path, 500)
    first = list(blocks)
    path.unlink()
    assert [len(f) for f in blocks] == [len(f) for f in first]
    assert sum(len(f) for f in first) == 100
