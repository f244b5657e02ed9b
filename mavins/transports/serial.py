"""A serial line, by pyserial: opened for us alone, raw, and again whenever it comes back."""

from __future__ import annotations

import contextlib
import errno
import os
import termios
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from mavins.errors import TransportError
from mavins.transports.base import Say
from mavins.transports.stream import Connection, Reconnecting

if TYPE_CHECKING:
    from serial import Serial

LEAST_QUEUE_BYTES: Final = 2048
BITS_PER_BYTE: Final = 10
"""With the start and the stop bit."""
QUEUE_S: Final = 0.5
"""What is older than this would come too late."""


class SerialTransport(Reconnecting):
    """One serial device; its address is (device, 0).

    A device that is not there at the start is an error, as it may be a misspelt one; later it is waited for.
    """

    def __init__(
        self,
        device: str,
        baud: int,
        say: Say,
        trusted: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(f"serial {device}", (device, 0), say, clock)
        self.trusted = trusted
        self.announcement = f"open serial {device} {baud} baud"
        self._device = device
        self._baud = baud
        try:
            if not os.path.exists(device):
                raise TransportError(f"{self.name}: no such device{_present()}")
            self._take(self._open())
        except TransportError:
            self.close()
            raise

    def _attempt(self) -> None:
        try:
            self._take(self._open())
        except TransportError as error:
            self._failed(str(error).removeprefix(f"{self.name}: "))

    def _take(self, port: Serial) -> None:
        limit = max(LEAST_QUEUE_BYTES, round(self._baud / BITS_PER_BYTE * QUEUE_S))
        self._add(Connection(port.fileno(), self._peer, lambda: _close(port), limit, self.dropped))

    def _open(self) -> Serial:
        try:
            from serial import Serial
        except ImportError:
            raise TransportError(
                f"{self.name}: serial lines need pyserial: pip install 'mavins[serial]'"
            ) from None
        try:
            return Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise TransportError(f"{self.name}: {_why(self._baud, error)}") from error


def _close(port: Serial) -> None:
    """Close without waiting for what nobody takes any more."""
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(port.fileno(), termios.TCOFLUSH)
    with contextlib.suppress(OSError):
        port.close()


def _why(baud: int, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return "no such device"
    if number == errno.EACCES:
        return "not permitted: sudo usermod -a -G dialout $USER, then log in again"
    if number in (errno.EAGAIN, errno.EBUSY):
        return "in use by another program"
    if isinstance(error, ValueError):
        return f"it cannot do {baud} baud"
    if number is None:
        return "not a serial line"
    return os.strerror(number)


def _present() -> str:
    """The devices that are there, for a message."""
    try:
        from serial.tools.list_ports import comports
    except ImportError:
        return ""
    devices = sorted(port.device for port in comports())
    return f" (there are {', '.join(devices)})" if devices else ""
