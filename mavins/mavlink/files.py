"""The files that a vehicle of ours offers: what its parameters are, in the JSON that ground stations read.

Source: the MAVLink developer guide, component metadata protocol.
"""

from __future__ import annotations

import functools
import json
import zlib
from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import Final

GENERAL: Final = "general.json"
"""Names the other files; COMPONENT_METADATA names this one."""
PARAMETERS: Final = "parameter.json"
MAX_CLIENTS: Final = 32
"""More than this do not read at the same time: who opened a file first has to open it again."""
_TYPE_PARAMETER: Final = 1


class OpenFiles:
    """Which file each client reads: the one that it opened last."""

    def __init__(self) -> None:
        self._names: dict[Hashable, str] = {}

    def open(self, client: Hashable, name: str) -> None:
        """A client reads a file from now on."""
        self.close(client)
        self._names[client] = name
        if len(self._names) > MAX_CLIENTS:
            self.close(next(iter(self._names)))

    def close(self, client: Hashable) -> None:
        """It reads none any more."""
        self._names.pop(client, None)

    def name(self, client: Hashable) -> str:
        """What it reads; nothing is called ""."""
        return self._names.get(client, "")


def uri(name: str) -> str:
    """Where a file is to be had by MAVLink FTP."""
    return f"mftp:///{name}"


def crc32(content: bytes) -> int:
    """MAVLink's CRC32 of a file: that of zlib, but it begins at 0 and is not inverted at the end."""
    return zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF


@functools.lru_cache(maxsize=4)
def files_of(described: bytes) -> Mapping[str, bytes]:
    """The files by name, of a vehicle whose parameters are described so; none where nothing is."""
    if not described:
        return MappingProxyType({})
    entry = {"type": _TYPE_PARAMETER, "uri": uri(PARAMETERS), "fileCrc": crc32(described)}
    general = json.dumps({"version": 1, "metadataTypes": [entry]}).encode()
    return MappingProxyType({GENERAL: general, PARAMETERS: described})
