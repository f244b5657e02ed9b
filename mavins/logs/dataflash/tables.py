"""Rows of a log that grow as it is read, and how bad stamps are kept out of them."""

from __future__ import annotations

from bisect import bisect_left
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mavins.types import FloatArray, IntArray

ALONE_US: Final = 10_000_000
"""The first or last of some rows is not believed if it is so far from the others."""


class Table:
    """Rows (N, width) in increasing time, at most one per `period_us`; `dropped` counts those with other stamps."""

    def __init__(self, dtype: DTypeLike = np.float64, period_us: int = 0) -> None:
        self._t_us: IntArray = np.empty(0, np.int64)
        self._rows: NDArray[Any] = np.empty((0, 0), dtype)
        self._count = 0
        self._period_us = period_us
        self.dropped = 0

    def __len__(self) -> int:
        return self._count

    @property
    def t_us(self) -> IntArray:
        """Stamps (N,)."""
        return self._t_us[: self._count]

    @property
    def rows(self) -> FloatArray:
        """Readings (N, width)."""
        return self._rows[: self._count]

    def release(self) -> tuple[IntArray, FloatArray]:
        """Stamps (N,) and readings (N, width), which are forgotten here."""
        self._t_us.resize(self._count, refcheck=False)
        self._rows.resize((self._count, self._rows.shape[1]), refcheck=False)
        t_us, rows = self._t_us, self._rows
        self._t_us, self._rows, self._count = t_us[:0], rows[:0], 0
        return t_us, rows

    def append(self, t_us: IntArray, rows: FloatArray) -> None:
        """Take those of the rows (M, width) whose stamps go on from the ones before."""
        newest = int(self._t_us[self._count - 1]) if self._count else -1
        chosen = forward(t_us, newest)
        if len(chosen) < len(t_us):
            self.dropped += len(t_us) - len(chosen)
            t_us, rows = t_us[chosen], rows[chosen]
        if self._period_us:
            period = t_us // self._period_us
            first = np.diff(period, prepend=newest // self._period_us) > 0
            t_us, rows = t_us[first], rows[first]
        if not len(t_us):
            return
        end = self._count + len(t_us)
        if end > len(self._t_us):
            # grown in place, so that there are never two of them
            room = end + end // 8 + 256
            self._t_us.resize(room, refcheck=False)
            self._rows.resize((room, rows.shape[1]), refcheck=False)
        self._t_us[self._count : end] = t_us
        self._rows[self._count : end] = rows
        self._count = end


def forward(t_us: IntArray, after: int) -> IntArray:
    """Which stamps (M,) to take, so that they increase, from `after` on: as many as possible."""
    usable = np.flatnonzero(t_us > after)
    stamps = t_us[usable]
    if not (np.diff(stamps) > 0).all():
        usable = usable[_longest_increase(stamps)]
        stamps = t_us[usable]
    first, last = 0, len(stamps)
    while last - first > 2 and stamps[last - 1] - stamps[last - 2] > ALONE_US:
        last -= 1
    while last - first > 2 and stamps[first + 1] - stamps[first] > ALONE_US:
        first += 1
    return usable[first:last]


def _longest_increase(stamps: IntArray) -> IntArray:
    """Where one of the longest increasing subsequences lies (patience sorting)."""
    tails: list[int] = []
    at: list[int] = []
    before: list[int] = []
    for k, t in enumerate(stamps.tolist()):
        i = bisect_left(tails, t)
        before.append(at[i - 1] if i else -1)
        if i == len(tails):
            tails.append(t)
            at.append(k)
        elif t < tails[i]:  # of equal ones the first is kept
            tails[i], at[i] = t, k
    chain = []
    k = at[-1] if at else -1
    while k >= 0:
        chain.append(k)
        k = before[k]
    return np.array(chain[::-1], np.int64)
