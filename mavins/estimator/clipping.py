"""Where the accelerometer was at its limit: a reading there says little of the motion, and must weigh little.

Theory: docs/theory/mechanization.md.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from mavins.types import IntArray


class Clipped:
    """The stamps of the IMU rows whose readings were clipped."""

    def __init__(self) -> None:
        self._t_us: list[int] = []

    def __bool__(self) -> bool:
        return bool(self._t_us)

    def mark(self, t_us: IntArray) -> None:
        """Add stamps (N,)."""
        self._t_us += t_us.tolist()
        self._t_us.sort()

    def stamps(self) -> IntArray:
        """All of them (N,), in order."""
        return np.array(self._t_us, dtype=np.int64)

    def forget_before(self, t_us: int) -> None:
        """Drop the stamps of rows that are gone."""
        if self._t_us and self._t_us[0] < t_us:
            del self._t_us[: bisect_left(self._t_us, t_us)]

    def run(self, t_us: IntArray) -> tuple[int, bool]:
        """How many of the first rows, with stamps t_us (N,), are alike, and whether those are clipped."""
        i = bisect_left(self._t_us, int(t_us[0]))
        if i == len(self._t_us):
            return len(t_us), False
        if self._t_us[i] > t_us[0]:
            return int(t_us.searchsorted(self._t_us[i])), False
        n = 1
        while n < len(t_us) and self._t_us[i + n : i + n + 1] == [int(t_us[n])]:
            n += 1
        return n, True
