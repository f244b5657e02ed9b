"""What is in a dataflash log, for people: how many messages of each kind at what rate, and what wrote it."""

from __future__ import annotations

import re
from typing import Final

from mavins.logs.dataflash.formats import Batch, Format
from mavins.types import IntArray

_VERSION: Final = re.compile(rb"[\x20-\x7e]* V\d[\x20-\x7e]*")


class Survey:
    """Counts of messages by name, and the stamps between which they were written."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._spans: dict[str, tuple[int, int]] = {}

    def add(self, name: str, count: int, t_us: IntArray) -> None:
        """Some messages of one kind in the order of the log, and their stamps, of which the first and last count."""
        self._counts[name] = self._counts.get(name, 0) + count
        if len(t_us) and 0 <= t_us[0] <= t_us[-1]:
            self._spans[name] = self._spans.get(name, (int(t_us[0]), 0))[0], int(t_us[-1])

    def messages(self) -> dict[str, tuple[int, float]]:
        """Name -> (messages, Hz), 0 where there is no rate."""
        found = {}
        for name, count in sorted(self._counts.items()):
            first, last = self._spans.get(name, (0, 0))
            found[name] = count, (count - 1) / ((last - first) * 1e-6) if last > first else 0.0
        return found


class Firmware:
    """The firmware's name, which is among the first messages to people."""

    def __init__(self) -> None:
        self.name = ""

    def fields_of(self, form: Format) -> tuple[str, ...]:
        """The text of MSG."""
        fits = form.name == "MSG" and form.has("Message") and form.character("Message") == "Z"
        return ("Message",) if fits else ()

    def take(self, batch: Batch) -> None:
        """Look for the name."""
        for text in batch.columns["Message"].tolist():
            if not self.name and _VERSION.fullmatch(text):
                self.name = text.decode("ascii")
