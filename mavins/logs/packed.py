"""Files that may be packed in .gz, .xz or .zst, told by content, read as streams of what is in them."""

from __future__ import annotations

import io
import lzma
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, NamedTuple, Protocol

from mavins.errors import LogFormatError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_CHUNK: Final = 1 << 14
_BUFFER: Final = 1 << 18


def open_packed(path: str | Path) -> IO[bytes]:
    """A file for reading, unpacked where it is packed; only one that is not can be sought in.

    Of a packed file that is cut off or damaged all is read that can be unpacked; `fault_of` tells afterwards what
    came in between. Raises LogFormatError for what cannot be read, is empty, or holds nothing that can be unpacked.
    """
    try:
        file = io.BufferedReader(io.FileIO(path), _BUFFER)
        head = file.peek(8)[:8]
    except OSError as error:
        raise LogFormatError(f"cannot read {path}: {error.strerror}") from error
    for magic, packing in _PACKINGS.items():
        if head.startswith(magic):
            unpacked = _Unpacked(file, packing())
            stream = io.BufferedReader(unpacked, _BUFFER)
            if stream.peek(1):
                return stream
            stream.close()
            raise LogFormatError(
                f"{path} is damaged: {unpacked.fault}" if unpacked.fault else f"{path} is empty"
            )
    if not head:
        file.close()
        raise LogFormatError(f"{path} is empty")
    return file


def fault_of(stream: IO[bytes]) -> str:
    """Why a stream of `open_packed` that was read to its end ended early; empty where it did not."""
    raw = getattr(stream, "raw", None)
    return raw.fault if isinstance(raw, _Unpacked) else ""


class _Unpacker(Protocol):
    """What zlib, lzma and zstandard have in common: it unpacks one packed stream, and says where that ends."""

    @property
    def eof(self) -> bool: ...

    @property
    def unused_data(self) -> bytes: ...

    def decompress(self, data: bytes, /) -> bytes: ...


class _Packing(NamedTuple):
    """What makes an unpacker, and what that raises on damage."""

    unpacker: Callable[[], _Unpacker]
    error: type[Exception]


def _zstandard() -> _Packing:
    import zstandard  # of the extra `logs`

    return _Packing(lambda: zstandard.ZstdDecompressor().decompressobj(), zstandard.ZstdError)


_PACKINGS: Final[dict[bytes, Callable[[], _Packing]]] = {
    b"\x1f\x8b": lambda: _Packing(lambda: zlib.decompressobj(wbits=31), zlib.error),
    b"\xfd7zXZ\x00": lambda: _Packing(lzma.LZMADecompressor, lzma.LZMAError),
    b"\x28\xb5\x2f\xfd": _zstandard,
}
"""How a packed file begins -> its packing."""


class _Unpacked(io.RawIOBase):
    """What a packed file holds, of which several may follow each other; it ends where it cannot be unpacked."""

    def __init__(self, file: IO[bytes], packing: _Packing) -> None:
        self._file = file
        self._packing = packing
        self._unpacker = packing.unpacker()
        self._rest = memoryview(b"")
        self._ended = False
        self.fault = ""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        target = memoryview(buffer).cast("B")
        while not self._rest and not self._ended:
            self._rest = memoryview(self._next())
        n = min(len(target), len(self._rest))
        target[:n] = self._rest[:n]
        self._rest = self._rest[n:]
        return n

    def _next(self) -> bytes:
        """The next piece, which may be empty."""
        try:
            packed = self._file.read(_CHUNK)
            if self._unpacker.eof:
                packed = self._unpacker.unused_data + packed
                self._unpacker = self._packing.unpacker()
                if not packed.strip(b"\0"):  # nothing, or padding
                    self._ended = True
                    return b""
            elif not packed:
                self._end("cut off")
                return b""
            return self._unpacker.decompress(packed)
        except (OSError, self._packing.error) as error:
            self._end(str(error))
            return b""

    def _end(self, fault: str) -> None:
        self._ended = True
        self.fault = fault

    def close(self) -> None:
        self._file.close()
        super().close()
