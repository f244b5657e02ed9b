"""MAVLink FTP: files are read whole however a client goes about it, and nothing that it sends does harm."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect
from pymavlink.generator.mavcrc import x25crc
from pymavlink.mavftp_op import FTP_OP

from mavins.config import Config
from mavins.mavlink.codec import frame, scan
from mavins.mavlink.codec.component_metadata import component_metadata
from mavins.mavlink.files import GENERAL, MAX_CLIENTS, PARAMETERS, OpenFiles, crc32, files_of
from mavins.mavlink.ftp import BURST, MAX_DATA, FileTransfer, Reader
from mavins.mavlink.microservice import Request
from mavins.mavlink.parameters import NoParameters, VehicleParameters
from mavins.mavlink.requests import decode_packet
from mavins.parameters import ConfigStore

ACK, NAK = 128, 129
INVALID_SIZE, INVALID_SESSION, END_OF_FILE, UNKNOWN_COMMAND, NOT_FOUND = 3, 4, 6, 7, 10
TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST_READ = 1, 2, 3, 4, 5, 14, 15
DESCRIBED = json.dumps({"parameters": ["x" * k for k in range(120)]}).encode()


class Owner:
    """A vehicle as the service sees it."""

    def __init__(self, described: bytes = DESCRIBED) -> None:
        store = NoParameters()
        store.described = lambda: described  # type: ignore[method-assign]
        self.parameters = VehicleParameters(store)
        self.opened = OpenFiles()


def talk(
    owner: Owner,
    opcode: int,
    data: bytes = b"",
    *,
    size: int | None = None,
    session: int = 0,
    offset: int = 0,
    sequence: int = 7,
    sender: tuple[int, int] = (255, 190),
) -> list[FTP_OP]:
    """The answers as pymavlink's own client parts them."""
    asked = FTP_OP(sequence, session, opcode, size or len(data), 0, 0, offset, data).pack()
    return send(owner, list(asked), sender)


def send(owner: Owner, body: list[int], sender: tuple[int, int] = (255, 190)) -> list[FTP_OP]:
    body = body + [0] * (251 - len(body))
    message = dialect.MAVLink_file_transfer_protocol_message(0, 100, 1, body)
    heard = decode_packet(scan(message.pack(dialect.MAVLink(None, 255, 190))), 0)
    request = Request(heard, sender, "here", False, 0)
    link, found = dialect.MAVLink(None), []
    for reply in FileTransfer().answer(request, owner):
        answer = link.decode(bytearray(frame(reply.payload, 100, 1, 0)))
        assert (answer.target_system, answer.target_component) == sender
        raw = bytes(answer.payload)
        sequence, session, opcode, size, asked, complete, offset = struct.unpack_from(
            "<HBBBBBxI", raw
        )
        data = raw[12 : 12 + size]
        found.append(FTP_OP(sequence, session, opcode, size, asked, complete, offset, data))
    return found


def only(answers: list[FTP_OP]) -> FTP_OP:
    (answer,) = answers
    return answer


def refused(answers: list[FTP_OP]) -> int:
    answer = only(answers)
    assert (answer.opcode, answer.size) == (NAK, 1)
    return int(answer.payload[0])


def test_the_files_describe_each_other() -> None:
    owner = Owner()
    assert only(talk(owner, LIST, b"/")).payload.split(b"\0") == [
        f"F{GENERAL}\t{len(files_of(DESCRIBED)[GENERAL])}".encode(),
        f"F{PARAMETERS}\t{len(DESCRIBED)}".encode(),
        b"",
    ]
    assert refused(talk(owner, LIST, b"/", offset=2)) == END_OF_FILE
    assert refused(talk(owner, LIST, b"/elsewhere")) == NOT_FOUND
    (entry,) = json.loads(files_of(DESCRIBED)[GENERAL])["metadataTypes"]
    assert entry["uri"] == f"mftp:///{PARAMETERS}"
    (crc,) = struct.unpack("<I", only(talk(owner, CRC, b"/parameter.json\0")).payload)
    assert crc == entry["fileCrc"] == bitwise_crc32(DESCRIBED)


def bitwise_crc32(data: bytes) -> int:
    """CRC32 as MAVLink has it: reflected, from 0, not inverted."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    return crc


def read_by_pieces(owner: Owner, size: int, length: int) -> bytes:
    content = b""
    while len(content) < length:
        piece = only(talk(owner, READ, size=size, offset=len(content)))
        assert (piece.opcode, piece.offset) == (ACK, len(content))
        content += piece.payload
    assert refused(talk(owner, READ, size=size, offset=len(content))) == END_OF_FILE
    return content


def read_by_bursts(owner: Owner, size: int, length: int) -> bytes:
    content, sequence = b"", 65_530
    while True:
        pieces = talk(owner, BURST_READ, size=size, offset=len(content), sequence=sequence)
        if pieces[-1].opcode == NAK:
            assert refused(pieces[-1:]) == END_OF_FILE
            content += b"".join(piece.payload for piece in pieces[:-1])
            return content
        assert [piece.burst_complete for piece in pieces] == [0] * (len(pieces) - 1) + [1]
        assert len(pieces) <= BURST
        for piece in pieces:
            sequence = (sequence + 1) % 65_536
            assert (piece.seq, piece.offset) == (sequence, len(content))
            content += piece.payload
        if pieces[-1].size < size:
            return content


@pytest.mark.parametrize("read", [read_by_pieces, read_by_bursts])
@pytest.mark.parametrize("size", [1, 80, 120, MAX_DATA])
def test_a_file_is_read_whole(read: Callable[[Owner, int, int], bytes], size: int) -> None:
    described = DESCRIBED[: 20 * 120]  # whole pieces too
    owner = Owner(described)
    opened = only(talk(owner, OPEN, b"/parameter.json"))
    assert (opened.opcode, opened.session) == (ACK, 0)
    (length,) = struct.unpack("<I", opened.payload)
    assert read(owner, size, length) == described
    assert only(talk(owner, TERMINATE)).opcode == ACK
    assert refused(talk(owner, READ, size=size)) == INVALID_SESSION
    assert refused(talk(owner, TERMINATE)) == INVALID_SESSION


def test_two_clients_read_two_files() -> None:
    owner, other = Owner(), (254, 1)
    talk(owner, OPEN, PARAMETERS.encode())
    talk(owner, OPEN, GENERAL.encode(), sender=other)
    assert only(talk(owner, READ, size=9)).payload == DESCRIBED[:9]
    assert only(talk(owner, READ, size=9, sender=other)).payload == b'{"version'
    assert only(talk(owner, RESET, sender=other)).opcode == ACK
    assert only(talk(owner, READ, size=9)).payload == DESCRIBED[:9]


def test_clients_are_bounded() -> None:
    opened = OpenFiles()
    for client in range(MAX_CLIENTS + 1):
        opened.open(client, str(client))
    assert [opened.name(k) for k in (0, 1, MAX_CLIENTS)] == ["", "1", str(MAX_CLIENTS)]


@pytest.mark.parametrize(
    ("opcode", "data", "size", "error"),
    [
        (OPEN, b"@PARAM/param.pck", None, NOT_FOUND),  # on which MAVProxy lists the parameters
        (OPEN, b"../parameter.json", None, NOT_FOUND),
        (OPEN, b"\xff\xfe", None, NOT_FOUND),
        (CRC, b"nothing", None, NOT_FOUND),
        (READ, b"", 5, INVALID_SESSION),
        (BURST_READ, b"", 5, INVALID_SESSION),
        (0, b"", None, NOT_FOUND),
        (6, b"/parameter.json", None, NOT_FOUND),  # create
        (8, b"/parameter.json", None, NOT_FOUND),  # remove
        (16, b"/", None, UNKNOWN_COMMAND),
        (127, b"", None, UNKNOWN_COMMAND),
    ],
)
def test_what_is_refused(opcode: int, data: bytes, size: int | None, error: int) -> None:
    answer = only(talk(Owner(), opcode, data, size=size, sequence=65_535, offset=4))
    assert refused([answer]) == error
    assert (answer.seq, answer.req_opcode, answer.offset) == (0, opcode, 4)


@pytest.mark.parametrize("size", [0, MAX_DATA + 1, 255])
def test_a_piece_of_an_impossible_size(size: int) -> None:
    owner = Owner()
    talk(owner, OPEN, PARAMETERS.encode())
    assert refused(send(owner, [0, 0, 0, READ, size])) == INVALID_SIZE
    assert refused(send(owner, [0, 0, 0, BURST_READ, size])) == INVALID_SIZE
    assert refused(talk(owner, READ, size=5, session=1)) == INVALID_SESSION


def test_a_vehicle_without_parameters_has_no_files() -> None:
    owner = Owner(b"")
    assert refused(talk(owner, OPEN, GENERAL.encode())) == NOT_FOUND
    assert refused(talk(owner, LIST, b"/")) == END_OF_FILE


@given(
    st.lists(
        st.one_of(
            st.binary(min_size=251, max_size=251),
            st.builds(
                lambda code, size, offset, data: (
                    struct.pack("<HBBBBBxI", 1, 0, code, size, 0, 0, offset) + data
                ),
                st.sampled_from([TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST_READ]),
                st.integers(0, 255),
                st.one_of(st.integers(0, 9000), st.integers(0, 2**32 - 1)),
                st.sampled_from([b"", b"/", b"/general.json", b"parameter.json\0", b"\xff" * 239]),
            ),
        ),
        max_size=8,
    )
)
def test_whatever_comes_is_answered_once_or_in_a_bounded_burst(bodies: list[bytes]) -> None:
    owner = Owner()
    for body in bodies:
        answers = send(owner, list(body))
        assert len(answers) == 0 if body[3] >= ACK else 1 <= len(answers) <= BURST
        assert {answer.opcode for answer in answers} <= {ACK, NAK}
        assert all(answer.size <= MAX_DATA for answer in answers)


def test_the_program_describes_its_own_parameters() -> None:
    store = ConfigStore(Config(), lambda config: None, lambda config: "")
    names = [p["name"] for p in json.loads(store.described())["parameters"]]
    assert names == list(store.names)
    assert store.described() is store.described()
    reader = Reader(files_of(store.described()), OpenFiles(), "here")
    assert set(reader.files) == {GENERAL, PARAMETERS}


def test_the_message_that_names_the_files() -> None:
    made = component_metadata(5_000_000, 0xDEADBEEF, "mftp:///general.json")
    assert made.body == struct.pack("<II", 5000, 0xDEADBEEF) + b"mftp:///general.json".ljust(
        100, b"\0"
    )
    # crc_extra as MAVLink defines it, over the message's name and fields
    text = b"COMPONENT_METADATA uint32_t time_boot_ms uint32_t file_crc char uri " + bytes((100,))
    crc = x25crc(text).crc
    assert (made.msgid, made.crc_extra) == (397, (crc & 0xFF) ^ (crc >> 8))
    # whose dialect lacks it is not troubled
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    (heard,) = parser.parse_buffer(frame(made, 100, 1, 0))
    assert heard.get_type() == "UNKNOWN_397"
    assert crc32(b"") == 0
