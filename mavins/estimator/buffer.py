"""The IMU samples of the last seconds as one contiguous table, addressed by a row number that never changes meaning
except when a late sample is put in between."""

from __future__ import annotations

import numpy as np

from mavins.types import FloatArray, IntArray


class ImuBuffer:
    """IMU rows in the order of their stamps: `t_us` and readings [gyro_b, accel_b] (6,).

    Rows are numbered from the first one ever appended; old ones are dropped, the numbers of the others stay.
    `newest_us` is the newest stamp, -1 before the first.
    """

    def __init__(self, capacity: int = 1024) -> None:
        self._t = np.empty(capacity, dtype=np.int64)
        self._imu = np.empty((capacity, 6))
        self._first = 0
        self._length = 0
        self.newest_us = -1

    @property
    def first(self) -> int:
        """The number of the oldest row kept."""
        return self._first

    @property
    def end(self) -> int:
        """One more than the number of the newest row."""
        return self._first + self._length

    def __len__(self) -> int:
        return self._length

    @property
    def oldest_us(self) -> int:
        """The oldest stamp kept."""
        return int(self._t[0])

    def clear(self) -> None:
        """Forget all rows; the numbering goes on."""
        self._first = self.end
        self._length = 0

    def append(self, t_us: IntArray, imu: FloatArray) -> None:
        """Add rows whose stamps all follow the newest."""
        n = len(t_us)
        if self._length + n > len(self._t):
            self._grow(self._length + n)
        self._t[self._length : self._length + n] = t_us
        self._imu[self._length : self._length + n] = imu
        self._length += n
        if n:
            self.newest_us = int(t_us[-1])

    def insert(self, t_us: int, reading: FloatArray) -> int:
        """Put a late row where it belongs and return its number; later rows move up by one."""
        i = int(self._t[: self._length].searchsorted(t_us))
        if self._length + 1 > len(self._t):
            self._grow(self._length + 1)
        end = self._length
        self._t[i + 1 : end + 1] = self._t[i:end].copy()
        self._imu[i + 1 : end + 1] = self._imu[i:end].copy()
        self._t[i] = t_us
        self._imu[i] = reading
        self._length += 1
        self.newest_us = max(self.newest_us, t_us)
        return self._first + i

    def drop_before(self, t_us: int) -> None:
        """Drop rows older than t_us, but keep the last one before it: an interval begins at its older sample.

        Rows move in memory only when half of the table is stale, so that a row is moved about once.
        """
        stale = int(self._t[: self._length].searchsorted(t_us)) - 1
        if stale < len(self._t) // 2:
            return
        kept = self._length - stale
        self._t[:kept] = self._t[stale : self._length].copy()
        self._imu[:kept] = self._imu[stale : self._length].copy()
        self._length = kept
        self._first += stale

    def contains(self, t_us: int) -> bool:
        """True where a row has exactly this stamp."""
        i = int(self._t[: self._length].searchsorted(t_us))
        return i < self._length and int(self._t[i]) == t_us

    def times(self, first: int, end: int) -> IntArray:
        """Stamps of rows first to end (exclusive), a view."""
        return self._t[first - self._first : end - self._first]

    def readings(self, first: int, end: int) -> FloatArray:
        """Readings (N, 6) of rows first to end (exclusive), a view."""
        return self._imu[first - self._first : end - self._first]

    def stamp(self, row: int) -> int:
        """The stamp of one row."""
        return int(self._t[row - self._first])

    def row_after(self, t_us: int) -> int:
        """The number of the first row with a stamp later than t_us."""
        if t_us >= self.newest_us:
            return self._first + self._length
        return self._first + int(self._t[: self._length].searchsorted(t_us, "right"))

    def reading_at(self, t_us: int) -> FloatArray:
        """The reading (6,) at an instant between two rows, on the line that joins them."""
        i = int(self._t[: self._length].searchsorted(t_us))
        if i == 0 or int(self._t[i]) == t_us:
            exact: FloatArray = self._imu[i].copy()
            return exact
        t0, t1 = int(self._t[i - 1]), int(self._t[i])
        s = (t_us - t0) / (t1 - t0)
        between: FloatArray = self._imu[i - 1] + s * (self._imu[i] - self._imu[i - 1])
        return between

    def _grow(self, needed: int) -> None:
        capacity = max(needed, 2 * len(self._t))
        t = np.empty(capacity, dtype=np.int64)
        imu = np.empty((capacity, 6))
        t[: self._length] = self._t[: self._length]
        imu[: self._length] = self._imu[: self._length]
        self._t, self._imu = t, imu
