"""MAVLink FTP: a few files to be read, and nothing to be written.

Each client has one session, number 0 (MAVSDK takes no other), with the file that it opened last. Source: the MAVLink
developer guide, file transfer.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, Protocol

from mavins.mavlink.codec import Payload, fields_of, payload
from mavins.mavlink.files import OpenFiles, crc32, files_of
from mavins.mavlink.microservice import Reply, Request
from mavins.mavlink.parameters import VehicleParameters

FTP: Final = fields_of("FILE_TRANSFER_PROTOCOL")
TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST_READ = 1, 2, 3, 4, 5, 14, 15
ACK: Final = 128
NAK: Final = 129
INVALID_DATA_SIZE: Final = 3
INVALID_SESSION: Final = 4
END_OF_FILE: Final = 6
UNKNOWN_COMMAND: Final = 7
FILE_NOT_FOUND: Final = 10
MAX_DATA: Final = 239
BURST: Final = 6
"""Packets that one request brings at most: more would wait in a slow line's queue before all else."""
_HEADER: Final = struct.Struct("<HBBBBBxI")


@dataclass(frozen=True, slots=True)
class Packet:
    """One request or answer; `asked` is the opcode that is answered, `size` may differ from the data's length."""

    sequence: int
    session: int
    opcode: int
    size: int
    asked: int = 0
    complete: int = 0
    offset: int = 0
    data: bytes = b""

    @classmethod
    def of(cls, body: bytes) -> Packet:
        """The packet in 251 bytes."""
        sequence, session, opcode, size, asked, complete, offset = _HEADER.unpack_from(body)
        data = body[_HEADER.size : _HEADER.size + size]
        return cls(sequence, session, opcode, size, asked, complete, offset, data)

    def pack(self) -> bytes:
        """The 251 bytes."""
        head = (self.sequence, self.session, self.opcode, self.size, self.asked, self.complete)
        return (_HEADER.pack(*head, self.offset) + self.data).ljust(251, b"\0")

    @property
    def path(self) -> str:
        """The data as a path without its leading slashes."""
        return self.data.partition(b"\0")[0].decode("utf-8", "replace").lstrip("/")

    def ack(self, data: bytes = b"") -> Packet:
        """It is done."""
        return replace(self._answer(ACK), size=len(data), data=data)

    def nak(self, error: int) -> Packet:
        """It cannot be done."""
        return replace(self._answer(NAK), size=1, data=bytes((error,)))

    def _answer(self, opcode: int) -> Packet:
        sequence = (self.sequence + 1) % 65536
        return replace(self, sequence=sequence, opcode=opcode, asked=self.opcode, complete=0)


class Owner(Protocol):
    """Whose files they are."""

    @property
    def parameters(self) -> VehicleParameters:
        """The vehicle's parameters, which the files describe."""

    @property
    def opened(self) -> OpenFiles:
        """Who reads which."""


class FileTransfer:
    """The microservice of files."""

    msgids = frozenset((FTP.msgid,))

    def answer(self, request: Request, vehicle: Owner) -> Iterator[Reply]:
        """One packet, of a burst several."""
        asked = Packet.of(bytes(request.message.payload))
        if asked.opcode >= ACK:
            return
        system, component = request.sender
        files = files_of(vehicle.parameters.store.described())
        reader = Reader(files, vehicle.opened, (request.address, request.sender))
        for packet in reader.answers(asked):
            body = tuple(packet.pack())
            yield Reply(
                payload(FTP, target_system=system, target_component=component, payload=body)
            )

    def tick(self, now_us: int, vehicle: Owner) -> Iterable[tuple[Hashable, Payload]]:
        """Nothing is paced."""
        return ()


@dataclass(frozen=True, slots=True)
class Reader:
    """What one client's requests are answered."""

    files: Mapping[str, bytes]
    opened: OpenFiles
    client: Hashable

    def answers(self, asked: Packet) -> Iterator[Packet]:
        """The answer to a request; who wants to write is told that there is no such file."""
        if asked.opcode == BURST_READ:
            yield from self._burst(asked)
            return
        handler = _HANDLERS.get(asked.opcode)
        if handler is not None:
            yield handler(self, asked)
        else:
            yield asked.nak(FILE_NOT_FOUND if asked.opcode < BURST_READ else UNKNOWN_COMMAND)

    def _content(self, asked: Packet) -> bytes | None:
        """The file of the session, or None."""
        return self.files.get(self.opened.name(self.client)) if asked.session == 0 else None

    def _open(self, asked: Packet) -> Packet:
        content = self.files.get(asked.path)
        if content is None:
            return asked.nak(FILE_NOT_FOUND)
        self.opened.open(self.client, asked.path)
        return replace(asked.ack(struct.pack("<I", len(content))), session=0)

    def _read(self, asked: Packet) -> Packet:
        content = self._content(asked)
        if content is None:
            return asked.nak(INVALID_SESSION)
        if not 0 < asked.size <= MAX_DATA:
            return asked.nak(INVALID_DATA_SIZE)
        if asked.offset >= len(content):
            return asked.nak(END_OF_FILE)
        return asked.ack(content[asked.offset : asked.offset + asked.size])

    def _burst(self, asked: Packet) -> Iterator[Packet]:
        """The next pieces, the last of them marked; who wants more asks again."""
        for k in range(BURST):
            packet = self._read(asked)
            # a piece that is not full is the last one of the file
            last = k == BURST - 1 or packet.size < asked.size
            yield replace(packet, complete=int(last))
            if last or packet.opcode == NAK:
                return
            asked = replace(asked, offset=asked.offset + packet.size, sequence=packet.sequence)

    def _list(self, asked: Packet) -> Packet:
        """The files of the only folder from number `offset` on; they fit into one packet."""
        if asked.path not in ("", "."):
            return asked.nak(FILE_NOT_FOUND)
        entries = [f"F{name}\t{len(content)}\0".encode() for name, content in self.files.items()]
        rest = b"".join(entries[asked.offset :])
        return asked.ack(rest) if rest else asked.nak(END_OF_FILE)

    def _crc(self, asked: Packet) -> Packet:
        content = self.files.get(asked.path)
        if content is None:
            return asked.nak(FILE_NOT_FOUND)
        return asked.ack(struct.pack("<I", crc32(content)))

    def _terminate(self, asked: Packet) -> Packet:
        if self._content(asked) is None:
            return asked.nak(INVALID_SESSION)
        return self._reset(asked)

    def _reset(self, asked: Packet) -> Packet:
        self.opened.close(self.client)
        return asked.ack()


_HANDLERS: Final[dict[int, Callable[[Reader, Packet], Packet]]] = {
    TERMINATE: Reader._terminate,
    RESET: Reader._reset,
    LIST: Reader._list,
    OPEN: Reader._open,
    READ: Reader._read,
    CRC: Reader._crc,
}
