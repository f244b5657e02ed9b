"""COMPONENT_METADATA (397): the one message of ours that pymavlink's dialects lack, though common.xml has it."""

from __future__ import annotations

import struct
from typing import Final

from mavins.mavlink.codec.encode import Payload, boot_ms

COMPONENT_METADATA: Final = 397
_CRC_EXTRA: Final = 182
_WIRE: Final = struct.Struct("<II100s")
"""time_boot_ms, file_crc, uri."""


def component_metadata(t_us: int, file_crc: int, uri: str) -> Payload:
    """Where a component's general metadata lie, and their CRC32."""
    return Payload(
        COMPONENT_METADATA, _CRC_EXTRA, _WIRE.pack(boot_ms(t_us), file_crc, uri.encode())
    )
