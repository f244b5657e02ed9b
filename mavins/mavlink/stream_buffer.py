"""Packets out of a stream, whose pieces end anywhere: what is not whole yet waits for its rest."""

from __future__ import annotations

from typing import Final

from mavins.mavlink.codec import incomplete_at, scan

PATIENCE_US: Final = 100_000
"""A packet of the longest kind takes half of this at 57600 baud."""


class StreamBuffer:
    """One direction of one stream.

    What is handed out is, put together, the stream. Scanned piece by piece it gives the packets that
    the stream gives when scanned at once, unless something was `overdue`. What is held is shorter
    than the longest packet, whatever comes.
    """

    def __init__(self) -> None:
        self._held = b""
        self._since_us = 0

    def push(self, piece: bytes, now_us: int) -> bytes:
        """The next piece came: all up to the first packet that is not whole yet."""
        if not self._held:
            self._since_us = now_us
        return self._hand_out(self._held + piece, 0, now_us)

    def overdue(self, now_us: int) -> bytes:
        """Give a packet up that has begun long ago, if it keeps whole ones behind it waiting.

        Else nothing is lost by further waiting: its rest may only be slow.
        """
        is_due = self._held and now_us - self._since_us > PATIENCE_US
        if not is_due or not len(scan(self._held[1:])):
            return b""
        return self._hand_out(self._held, 1, now_us)

    def rest(self) -> bytes:
        """What is held when the stream has ended."""
        rest, self._held = self._held, b""
        return rest

    def _hand_out(self, data: bytes, start: int, now_us: int) -> bytes:
        """All of `data` but the packet that is not whole, which begins at `start` or behind it."""
        end = start + incomplete_at(data[start:])
        if end:
            self._since_us = now_us
        self._held = data[end:]
        return data[:end]
