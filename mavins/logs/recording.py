"""The recording of a live service: telemetry logs of a bounded size, and nothing that could stop the service.

With a bound, `flight.tlog` is followed by `flight.1.tlog`, `flight.2.tlog` and so on: a file is never renamed, never
removed and never written over, and a later run goes on after the highest number. `cat` in that order makes one log of
them. Each ends with a whole packet.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from mavins.errors import OutputError
from mavins.logs.tlog import TlogWriter
from mavins.mavlink.codec.framing import STAMP_LENGTH


class Recording:
    """Appends packets until it is closed, or until the disk refuses: then `warn` is told once, and `lost` counts.

    `max_size` bounds each file in bytes; None: one file, which is written anew.
    """

    def __init__(
        self, path: Path, max_size: int | None = None, warn: Callable[[str], None] = lambda _: None
    ) -> None:
        self.lost = 0
        self._path = path
        self._max_size = max_size
        self._warn = warn
        self._number = 0 if max_size is None else _first_free(path)
        self._size = 0
        self._stopped = False
        self._log = TlogWriter(part_path(path, self._number))

    @property
    def path(self) -> Path:
        """The file that is written to now."""
        return part_path(self._path, self._number)

    def write(self, t_us: int, packet: bytes) -> None:
        """Append one packet received at `t_us` (integer microseconds)."""
        size = STAMP_LENGTH + len(packet)
        if self._max_size is not None and self._size + size > self._max_size:
            self._guard(self._next_part)
        if self._stopped:
            self.lost += 1
            return
        self._size += size
        self._guard(lambda: self._log.write(t_us, packet))

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        self._guard(self._log.flush)

    def close(self) -> None:
        """Flush and close; further calls do nothing."""
        self._guard(self._log.close)

    def _next_part(self) -> None:
        self._log.close()
        self._number += 1
        self._size = 0
        self._log = TlogWriter(part_path(self._path, self._number))

    def _guard(self, action: Callable[[], None]) -> None:
        """Do it, or give up for good; what is in the file by then is whole and stays."""
        try:
            action()
        except OutputError as error:
            self.lost += self._log.discard()
            self._size = 0
            self._max_size = None
            if not self._stopped:
                self._warn(f"{error}; the recording ends here, the service goes on")
            self._stopped = True


def part_path(path: Path, number: int) -> Path:
    """`flight.tlog` and 3 -> `flight.3.tlog`; 0 -> as it is."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}") if number else path


def _first_free(path: Path) -> int:
    """The number after the highest that is there."""
    pattern = re.compile(rf"{re.escape(path.stem)}\.([1-9][0-9]*){re.escape(path.suffix)}")
    there = [int(m[1]) for p in path.parent.glob("*") if (m := pattern.fullmatch(p.name))]
    if there:
        return max(there) + 1
    return int(path.exists())
