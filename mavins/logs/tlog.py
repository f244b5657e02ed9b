"""Telemetry logs: of each packet 8 bytes of big-endian microseconds, then the packet as it was
received.

Mission Planner, QGroundControl and pymavlink write and read the same. A .gz or .xz around it is
told by content.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import lzma
import os
import zlib
from pathlib import Path
from types import TracebackType
from typing import IO, Final

from mavins.errors import LogFormatError, NotALogError, OutputError
from mavins.mavlink.codec.framing import STAMP_LENGTH, Frames, scan_tlog

_BUFFER: Final = 1 << 16
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
    """All intact packets of a .tlog, plain or in .gz or .xz; LogFormatError where there is none."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise LogFormatError(f"cannot read {path}: {error.strerror}") from error
    if not data:
        raise LogFormatError(f"{path} is empty")
    data = _decompressed(data, path)
    for magic, name in _OTHER_FORMATS.items():
        if data.startswith(magic):
            raise LogFormatError(f"{path} is {name}, not a MAVLink .tlog")
    frames = scan_tlog(data)
    # a few packets may turn up in any large file by chance
    if len(frames) == 0 or frames.damage.skipped_bytes > 0.9 * len(data):
        raise NotALogError(f"{path} is not a MAVLink .tlog: no packets with stamps in it")
    return frames


def _decompressed(data: bytes, path: str | Path) -> bytes:
    """What .gz or .xz wraps; of a file that was cut off, all up to the cut."""
    if data.startswith(b"\x1f\x8b"):
        stream: io.BufferedIOBase = gzip.GzipFile(fileobj=io.BytesIO(data))
    elif data.startswith(b"\xfd7zXZ\x00"):
        stream = lzma.LZMAFile(io.BytesIO(data))  # noqa: SIM115 (nothing to close)
    else:
        return data
    parts = []
    try:
        while part := stream.read(_BUFFER):
            parts.append(part)
    except (OSError, EOFError, lzma.LZMAError, zlib.error) as error:
        if not parts:
            raise LogFormatError(f"{path} is damaged: {error}") from error
    if not parts:
        raise LogFormatError(f"{path} is empty")
    return b"".join(parts)
