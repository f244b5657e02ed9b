"""ArduPilot dataflash logs, binary or as text."""

from mavins.logs.dataflash.reader import read_dataflash

__all__ = ["read_dataflash"]
