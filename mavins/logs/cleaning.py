"""What logs need before their readings can be fed: wild stamps out, the rest in order and once, and not too many."""

from __future__ import annotations

from collections import Counter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavins.types import FloatArray, IntArray

WILD_US: Final = 10_000_000
"""A stamp so far from the median of its neighbours is damaged; after a gap there are several of the new time."""
MAX_RATE: Final = 20.0
"""Hz: more readings of a magnetometer or barometer than this are averaged, for their errors last far longer than 50 ms
and each reading is an object on its way to the filter."""
_NEIGHBOURS: Final = 5


class Cleaner:
    """Sorts tables out; `dropped` counts the rows that hold no reading, `disorder` the stamps that went backwards."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self.disorder: Counter[str] = Counter()

    def rows(self, table: str, t_us: IntArray, usable: NDArray[np.bool_] | np.bool_) -> IntArray:
        """Which rows to take in which order: those that are usable, by their stamps, the first of each stamp."""
        self.dropped[f"{table} unusable"] += int((~usable).sum())
        rows = np.flatnonzero(usable)
        wild = wild_stamps(t_us[rows])
        self.dropped[f"{table} wild stamp"] += int(wild.sum())
        rows = rows[~wild]
        self.disorder[f"{table}_backwards"] += int((np.diff(t_us[rows]) < 0).sum())
        _, first = np.unique(t_us[rows], return_index=True)
        self.dropped[f"{table} repeated"] += len(rows) - len(first)
        chosen: IntArray = rows[first]
        return chosen


def wild_stamps(t_us: IntArray) -> NDArray[np.bool_]:
    """True for the stamps (N,) that do not fit in between the two before and the two after them."""
    if len(t_us) < _NEIGHBOURS:
        return np.zeros(len(t_us), dtype=np.bool_)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(t_us, _NEIGHBOURS // 2, mode="reflect"), _NEIGHBOURS
    )
    wild: NDArray[np.bool_] = abs(t_us - np.median(around, axis=1)) > WILD_US
    return wild


def thinned(t_us: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
    """Means of stamps (N,) and values (N, m) over spells of 1 / MAX_RATE, where there are more than that."""
    period = round(1e6 / MAX_RATE)
    if len(t_us) < 2 or (t_us[-1] - t_us[0]) / (len(t_us) - 1) >= period:
        return t_us, values
    _, first, counts = np.unique(t_us // period, return_index=True, return_counts=True)
    within = np.add.reduceat(t_us - np.repeat(t_us[first], counts), first)
    stamps: IntArray = t_us[first] + within.astype(np.int64) // counts
    return stamps, np.add.reduceat(values, first, axis=0) / counts[:, None]
