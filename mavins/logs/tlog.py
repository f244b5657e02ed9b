"""Telemetry logs: of each packet 8 bytes of big-endian microseconds, then the packet as it was
received.

Mission Planner, QGroundControl and pymavlink write and read the same. What packs it is told by
content (mavins/logs/packed.py).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from types import TracebackType
from typing import IO, Final

import numpy as np

from mavins.errors import LogFormatError, NotALogError, OutputError
from mavins.logs.packed import open_packed
from mavins.mavlink.codec.framing import STAMP_LENGTH, Damage, Frames, scan_tlog

_BUFFER: Final = 1 << 16
_LOOKED_AHEAD: Final = 2048
"""More than three of the longest packets."""
_LONGEST_GARBAGE: Final = 1 << 20
"""Bytes that are kept in the hope of a packet that begins in them."""
_OTHER_FORMATS: Final = {
    b"ULog\x01\x12\x35": "a PX4 .ulg",
    b"\xa3\x95\x80": "an ArduPilot dataflash .bin",
    b"PK\x03\x04": "a zip archive",
}


class TlogWriter:
    """Writes packets with their reception stamps. Records go out whole: a reader never sees half a
    one, and a disk that fills up in the midst of them is left with those that are whole.

    Give it a path, which it opens and closes, or an open binary file, which it only flushes.
    """

    def __init__(self, target: str | Path | IO[bytes]) -> None:
        self._owned = isinstance(target, str | Path)
        self._buffer = bytearray()
        self._pending = 0
        self._file: IO[bytes]
        if isinstance(target, str | Path):
            try:
                self._file = open(target, "wb", buffering=0)  # noqa: SIM115 (closed in close)
            except OSError as error:
                raise OutputError(f"cannot write {target}: {error.strerror}") from error
        else:
            self._file = target

    def write(self, t_us: int, packet: bytes) -> None:
        """Append one packet received at `t_us` (integer microseconds)."""
        self._buffer += t_us.to_bytes(STAMP_LENGTH, "big")
        self._buffer += packet
        self._pending += 1
        if len(self._buffer) >= _BUFFER:
            self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system; OutputError leaves it pending."""
        if not self._buffer:
            return
        rest = memoryview(bytes(self._buffer))
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError as error:
            self._take_back(len(self._buffer) - len(rest))
            raise OutputError(f"cannot write the log: {error.strerror}") from error
        self._buffer.clear()
        self._pending = 0

    def discard(self) -> int:
        """Drop what is pending; returns how many packets that were."""
        dropped, self._pending = self._pending, 0
        self._buffer.clear()
        return dropped

    def _take_back(self, written: int) -> None:
        """Cut off the part of the pending records that went out, so that no half record stays."""
        if written:
            with contextlib.suppress(OSError):
                self._file.seek(-written, os.SEEK_CUR)
                self._file.truncate()

    def close(self) -> None:
        """Flush, and close the file if it was opened here; further calls do nothing."""
        if self._file.closed:
            return
        try:
            self.flush()
        finally:
            if self._owned:
                self._file.close()

    def __enter__(self) -> TlogWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def read_tlog(path: str | Path) -> Frames:
    """All intact packets of a .tlog, also packed; LogFormatError where there is none."""
    with open_packed(path) as stream:
        data = stream.read()
    frames = scan_tlog(data)
    _check(path, data, len(data), len(frames), frames.damage.skipped_bytes)
    return frames


class Tlog:
    """The intact packets of a .tlog, block by block, as often as it is gone through.

    What it gives, put together, is what `read_tlog` gives. A log that is not large stays in memory; of another there
    is one block at a time. LogFormatError where there are no packets.
    """

    def __init__(self, path: Path, block_size: int = 1 << 23, keep: int = 1 << 25) -> None:
        self._path = path
        self._block_size = block_size
        self._keep = keep
        self._kept: list[Frames] | None = None

    def __iter__(self) -> Iterator[Frames]:
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[Frames] = []
        size = 0
        for frames in self._read():
            size += frames.data.size
            if size <= self._keep:
                kept.append(frames)
            else:
                kept.clear()
            yield frames
        if size <= self._keep:
            self._kept = kept

    def _read(self) -> Iterator[Frames]:
        packets = size = skipped = 0
        rest, head, last_us = b"", b"", 0
        with open_packed(self._path) as stream:
            is_last = False
            while not is_last:
                piece = stream.read(self._block_size)
                is_last = len(piece) < self._block_size
                head = head or piece[:16]
                frames, rest = _settled(rest + piece, last_us, is_last)
                size += len(piece)
                packets += len(frames)
                skipped += frames.damage.skipped_bytes
                if len(frames):
                    last_us = int(frames.t_us[-1])
                if len(frames) or frames.damage:
                    yield frames
        _check(self._path, head, size, packets, skipped)


def _settled(data: bytes, last_us: int, is_last: bool) -> tuple[Frames, bytes]:
    """The packets of a piece of a log that stay what they are, whatever follows it, and the rest of the piece.

    What becomes of a packet is decided by fewer than `_LOOKED_AHEAD` bytes behind its beginning.
    """
    frames = scan_tlog(data)
    if len(frames) and frames.start[0] < STAMP_LENGTH:
        # a stamp that was cut off is that of the packet before, which is in the piece before
        frames.t_us[np.cumsum(frames.t_us) == 0] = last_us
    if is_last:
        return frames, b""
    sure = int(frames.start.searchsorted(len(data) - _LOOKED_AHEAD))
    if sure == 0:
        # of a long piece without a packet nothing but its end can become one
        cut = len(data) - 2 * _LOOKED_AHEAD if len(data) > _LONGEST_GARBAGE else 0
        lost = Damage(skipped_bytes=cut)
        return Frames(frames.data, frames.table[:, :0].copy(), lost), data[cut:]
    end = int(frames.end[sure - 1])
    rest = data[end:]
    after = scan_tlog(rest).damage
    settled = Damage(*(a - b for a, b in zip(astuple(frames.damage), astuple(after), strict=True)))
    return Frames(frames.data, frames.table[:, :sure].copy(), settled), rest


def _check(path: str | Path, head: bytes, size: int, packets: int, skipped: int) -> None:
    for magic, name in _OTHER_FORMATS.items():
        if head.startswith(magic):
            raise LogFormatError(f"{path} is {name}, not a MAVLink .tlog")
    # a few packets may turn up in any large file by chance
    if packets == 0 or skipped > 0.9 * size:
        raise NotALogError(f"{path} is not a MAVLink .tlog: no packets with stamps in it")
