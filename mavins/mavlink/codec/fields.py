"""Where each field of a MAVLink message lies on the wire, taken from pymavlink's dialect at import.

The dialect is the only source of field tables: nothing here repeats a message definition. `WIRE` is
what the frame scanner needs of all messages, `fields_of` what the decoders and encoders need of
one.
"""

from __future__ import annotations

import functools
import math
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

_C_NAMES: Final = {
    "b": "int8_t",
    "B": "uint8_t",
    "h": "int16_t",
    "H": "uint16_t",
    "i": "int32_t",
    "I": "uint32_t",
    "q": "int64_t",
    "Q": "uint64_t",
    "f": "float",
    "d": "double",
    "c": "char",
    "s": "char",
}
_FLOAT32_MAX: Final = float(np.finfo(np.float32).max)

NAN_IS_UNKNOWN: Final = frozenset(
    {
        ("ODOMETRY", "pose_covariance"),
        ("ODOMETRY", "velocity_covariance"),
        ("HOME_POSITION", "q"),
    }
)
"""The fields in which MAVLink defines NaN as 'unknown'; in all others a NaN is never sent."""


@dataclass(frozen=True, slots=True)
class Fields:
    """The wire layout of one message.

    `names`, `codes` (struct characters) and `counts` (0 for a scalar) are in wire order, extensions
    last; `known` is the set of the names. `unpacker` and `dtype` cover the full payload of
    `unpacker.size` bytes; `min_length` is the payload without extensions, which is what a v1 packet
    carries at least.
    """

    msgid: int
    name: str
    crc_extra: int
    min_length: int
    names: tuple[str, ...]
    codes: str
    counts: tuple[int, ...]
    clamps: tuple[Callable[[float], float] | None, ...]
    unpacker: struct.Struct
    dtype: np.dtype[np.void]
    known: frozenset[str]

    def pack(self, **values: Any) -> bytes:
        """The full payload of the named values in wire units; out of range is clamped, a field not
        named is zero.
        """
        usual = self._pack_usual(values)
        return self._pack_any(values) if usual is None else usual

    def _pack_usual(self, values: dict[str, Any]) -> bytes | None:
        """The payload of finite numbers of their wire types and in their ranges; None of anything
        else.
        """
        if not values.keys() <= self.known:
            return None
        parts: list[Any] = []
        for name in self.names:
            value = values.get(name, 0)
            if type(value) is list:
                parts += value
            else:
                parts.append(value)
        try:
            # of finite numbers the sum is finite, or so large that clamping must see to it
            return self.unpacker.pack(*parts) if math.isfinite(sum(parts)) else None
        except (TypeError, OverflowError, struct.error):
            return None

    def _pack_any(self, values: dict[str, Any]) -> bytes:
        parts: list[Any] = []
        for name, count, clamp in zip(self.names, self.counts, self.clamps, strict=True):
            value = values.pop(name, 0)
            if clamp is None:
                parts.append(value or b"")
            elif count:
                parts.extend(map(clamp, value or (0,) * count))
            else:
                parts.append(clamp(value))
        if values:
            raise KeyError(f"{self.name} has no field {', '.join(values)}")
        return self.unpacker.pack(*parts)


@functools.cache
def _clamp_of(code: str, nan_is_unknown: bool) -> Callable[[float], float]:
    """The function that brings any number into the range of a wire type: rounded, clamped, NaN to
    zero.
    """
    if code in "fd":

        def clamp_real(value: float) -> float:
            if -_FLOAT32_MAX <= value <= _FLOAT32_MAX:
                return value
            if value != value:
                return math.nan if nan_is_unknown else 0.0
            return min(max(value, -_FLOAT32_MAX), _FLOAT32_MAX)

        return clamp_real
    bits = 8 * struct.calcsize(f"<{code}")
    signed = code.islower()
    low = -(1 << bits - 1) if signed else 0
    high = (1 << bits - signed) - 1

    def clamp_integer(value: float) -> int:
        if low <= value <= high:
            return min(round(value), high)  # a float may round up to a limit it cannot represent
        return 0 if value != value else low if value < low else high

    return clamp_integer


def _layout(message: Any) -> tuple[str, tuple[int, ...]]:
    """(codes, counts) of a message's fields in wire order."""
    tokens = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)
    return "".join(code for _, code in tokens), tuple(int(count or 0) for count, _ in tokens)


def _min_length(message: Any) -> int:
    """The payload length without extensions.

    The dialect does not mark extensions, but crc_extra covers exactly the fields before them, so
    the longest prefix with that checksum is the original message.
    """
    codes, counts = _layout(message)
    crc = crc16.mcrf4xx(f"{message.msgname} ".encode())
    length, found = 0, int(message.unpacker.size)
    for name, code, count in zip(message.ordered_fieldnames, codes, counts, strict=True):
        text = f"{_C_NAMES[code]} {name} ".encode() + (bytes([count]) if count else b"")
        crc = crc16.mcrf4xx(text, crc)
        length += struct.calcsize(f"<{count or ''}{code}")
        if (crc & 0xFF) ^ (crc >> 8) == message.crc_extra:
            found = length
    return found


def _wire_table() -> NDArray[np.int64]:
    table = np.full(max(dialect.mavlink_map) + 1, -1, np.int64)
    for msgid, message in dialect.mavlink_map.items():
        table[msgid] = message.crc_extra | _min_length(message) << 8 | message.unpacker.size << 16
    table.flags.writeable = False
    return table


WIRE: Final = _wire_table()
"""Of each message id: crc_extra | min_length << 8 | max_length << 16, or -1 for an id that the
dialect lacks.
"""


@functools.cache
def fields_of(name: str) -> Fields:
    """The wire layout of the message called `name`; KeyError for one that the dialect lacks."""
    msgid: int | None = getattr(dialect, f"MAVLINK_MSG_ID_{name}", None)
    if msgid is None or msgid not in dialect.mavlink_map:
        raise KeyError(f"no MAVLink message is called {name}")
    message = dialect.mavlink_map[msgid]
    codes, counts = _layout(message)
    columns: list[tuple[Any, ...]] = []
    for field, code, count in zip(message.ordered_fieldnames, codes, counts, strict=True):
        if code in "sc":
            columns.append((field, f"S{count or 1}"))
        elif count:
            columns.append((field, f"<{code}", (count,)))
        else:
            columns.append((field, f"<{code}"))
    return Fields(
        msgid=msgid,
        name=name,
        crc_extra=message.crc_extra,
        min_length=int(WIRE[msgid]) >> 8 & 0xFF,
        names=tuple(message.ordered_fieldnames),
        codes=codes,
        counts=counts,
        clamps=tuple(
            None if code in "sc" else _clamp_of(code, (name, field) in NAN_IS_UNKNOWN)
            for field, code in zip(message.ordered_fieldnames, codes, strict=True)
        ),
        unpacker=message.unpacker,
        dtype=np.dtype(columns),
        known=frozenset(message.ordered_fieldnames),
    )


def name_of(msgid: int) -> str:
    """The name of a message id, `UNKNOWN_n` where the dialect lacks it."""
    message = dialect.mavlink_map.get(msgid)
    return f"UNKNOWN_{msgid}" if message is None else str(message.msgname)
