"""Recordings: bounded files that make one log, whole packets to the last byte, and a disk that fills up."""

from __future__ import annotations

import errno
import io
import itertools
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil

from mavins.errors import OutputError
from mavins.logs.recording import Recording, part_path
from mavins.logs.tlog import TlogWriter, read_tlog
from mavins.mavlink.codec import frame, heartbeat, scan_tlog, system_time

T0 = 1_750_000_000_000_000
RECORD = 8 + len(frame(heartbeat(2, 3), 1, 1, 0))


def packets(n: int) -> list[bytes]:
    return [frame(system_time(T0, 1000 * k), 1, 1, k) for k in range(n)]


def record(path: Path, sent: list[bytes], max_size: int | None = None) -> Recording:
    recording = Recording(path, max_size)
    for k, packet in enumerate(sent):
        recording.write(T0 + k, packet)
    recording.close()
    return recording


class Disk(io.BytesIO):
    """A file on a disk with so much room."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room

    def write(self, data: object) -> int:
        part = bytes(data)[: self.room - self.tell()]  # type: ignore[call-overload]
        if not part:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(part)


# ---- parts ---------------------------------------------------------------------------------------


@given(
    lengths=st.lists(st.integers(1, 200), min_size=1, max_size=80), max_size=st.integers(300, 2000)
)
def test_parts_are_bounded_and_make_one_log(
    lengths: list[int], max_size: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("parts")
    path = folder / "flight.tlog"
    # any bytes will do
    sent = [bytes([k % 256]) * n for k, n in enumerate(lengths)]
    recording = record(path, sent, max_size)
    parts = [part_path(path, k) for k in range(len(list(folder.iterdir())))]
    assert recording.path == parts[-1]
    assert all(0 < part.stat().st_size <= max_size for part in parts)
    whole = b"".join((T0 + k).to_bytes(8, "big") + packet for k, packet in enumerate(sent))
    assert b"".join(part.read_bytes() for part in parts) == whole
    # no part was begun before the one before was full
    sizes = [part.stat().st_size for part in parts]
    assert all(a + b > max_size for a, b in itertools.pairwise(sizes))


def test_each_part_is_a_log_of_its_own(tmp_path: Path) -> None:
    path, sent = tmp_path / "flight.tlog", packets(200)
    record(path, sent, 1000)
    names = sorted((p.name for p in tmp_path.iterdir()), key=lambda n: (len(n), n))
    assert names[:3] == ["flight.tlog", "flight.1.tlog", "flight.2.tlog"]
    logs = [read_tlog(tmp_path / name) for name in names]
    assert not any(log.damage for log in logs)
    assert [log.packet(i) for log in logs for i in range(len(log))] == sent


def test_nothing_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    first = record(path, packets(100), 1000)
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    (tmp_path / "flight.old.tlog").write_text("another's")
    (tmp_path / "flight.07.tlog").write_text("another's")
    second = Recording(path, 1000)
    second.close()
    number = int(first.path.name.split(".")[1])
    assert second.path == part_path(path, number + 1)
    assert all(p.read_bytes() == content for p, content in before.items())


def test_without_a_bound_the_file_is_written_anew(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    record(path, packets(5))
    assert record(path, packets(3)).path == path
    assert len(read_tlog(path)) == 3


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        Recording(tmp_path / "no" / "folder.tlog")


# ---- a full disk ---------------------------------------------------------------------------------


@given(st.integers(0, 40 * RECORD), st.lists(st.integers(1, 5), min_size=1, max_size=8))
def test_a_disk_that_fills_up_is_left_with_whole_records(room: int, batches: list[int]) -> None:
    disk = Disk(room)
    log = TlogWriter(disk)
    given = written = 0
    for batch in batches:
        for _ in range(batch):
            log.write(T0 + given, frame(heartbeat(2, 3), 1, 1, given))
            given += 1
        try:
            log.flush()
        except OutputError:
            assert given * RECORD > room
            assert log.discard() == given - written
            break
        written = given
    frames = scan_tlog(disk.getvalue())
    assert len(frames) == written
    assert disk.tell() == len(disk.getvalue()) == written * RECORD
    assert not frames.damage


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_disk_is_told_once_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.symlink_to("/dev/full")
    said: list[str] = []
    recording = Recording(path, None, said.append)
    for packet in packets(10):
        recording.write(T0, packet)
    recording.flush()
    for packet in packets(7):
        recording.write(T0, packet)
    recording.flush()
    recording.close()
    recording.close()
    assert said == [
        "cannot write the log: No space left on device; the recording ends here, the service goes on"
    ]
    assert recording.lost == 17


def test_a_next_part_that_cannot_be_begun(tmp_path: Path) -> None:
    folder = tmp_path / "records"
    folder.mkdir()
    path, said = folder / "flight.tlog", list[str]()
    recording = Recording(path, 1000, said.append)
    part_path(path, 1).mkdir()
    for packet in packets(100):
        recording.write(T0, packet)
    recording.close()
    assert len(said) == 1
    assert "flight.1.tlog" in said[0]
    assert len(read_tlog(path)) + recording.lost == 100


# ---- a torn tail ---------------------------------------------------------------------------------


@given(data=st.data())
def test_a_torn_tail_costs_one_packet(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    sent = packets(20)
    path = tmp_path_factory.getbasetemp() / "torn.tlog"
    record(path, sent)
    whole = path.read_bytes()
    ends = [sum(8 + len(p) for p in sent[: k + 1]) for k in range(len(sent))]
    cut = data.draw(st.integers(ends[0], len(whole)))
    path.write_bytes(whole[:cut])
    n = sum(end <= cut for end in ends)
    frames = read_tlog(path)
    assert [frames.packet(i) for i in range(len(frames))] == sent[:n]
    log = mavutil.mavlink_connection(str(path))
    read = []
    while (message := log.recv_msg()) is not None:
        read.append(message)
    log.close()
    assert [m.time_boot_ms for m in read if m.get_type() == "SYSTEM_TIME"] == list(range(n))
    assert len(read) == n
