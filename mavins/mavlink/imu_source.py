"""One vehicle's IMU messages: which of them is used, chosen once, and its samples in SI units."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.mavlink.codec import (
    IMU_KINDS,
    WRAPPING_IMU_KINDS,
    Frames,
    ImuMessage,
    decode,
    decode_fields,
    decode_imu,
)
from mavins.types import FloatArray, ImuTable, IntArray

PREFERENCE: Final = tuple(IMU_KINDS)
"""IMU messages, the best first: HIGHRES_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3, RAW_IMU."""
CHOICE_US: Final = 1_000_000
"""A lesser IMU message is chosen only when nothing better has come for this long (reception time)."""
IMU_IDS: Final = np.array(sorted(IMU_KINDS), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Samples:
    """IMU samples of packets `at` (N,): stamps as sent, SI readings (N, 3), reception stamps (us).

    `field` (N, 3) is the magnetometer in the same packets, NaN where it has no reading; None if it is not asked for.
    """

    at: IntArray
    stamp_us: IntArray
    accel_b: FloatArray
    gyro_b: FloatArray
    received_us: IntArray
    field: FloatArray | None = None

    def table(self, t_us: IntArray, part: slice) -> tuple[ImuTable, FloatArray | None]:
        """The readings and fields of some of them, whose times (N,) are these."""
        field = None if self.field is None else self.field[part]
        return ImuTable(t_us, self.accel_b[part], self.gyro_b[part]), field


class ImuSource:
    """The message, sensor and component that a vehicle's samples are taken from.

    `chosen` is (message id, sensor id) once it is known; `compid` is the component of the first IMU message;
    `first_us` and `newest_us` are reception stamps. `with_field` asks for the magnetometer in the same message, too.
    """

    def __init__(self, dropped: Counter[str], with_field: bool = False) -> None:
        self.chosen: tuple[int, int] | None = None
        self.compid: int | None = None
        self.first_us: int | None = None
        self.newest_us = 0
        self._dropped = dropped
        self._with_field = with_field
        self._seen: dict[int, int] = {}

    @property
    def name(self) -> str:
        """The chosen message's name; empty before."""
        return "" if self.chosen is None else IMU_KINDS[self.chosen[0]]

    @property
    def wraps(self) -> bool:
        """True where the samples are stamped in boot milliseconds."""
        return self.name in WRAPPING_IMU_KINDS

    def offer(self, frames: Frames, i: int) -> bool:
        """Look at an IMU packet until the choice is made: the best kind at once, else the best within a second.

        Returns True if the choice is made now; else the packet is dropped and counted.
        """
        compid, received_us = int(frames.compid[i]), int(frames.t_us[i])
        if self.first_us is None:
            self.first_us = received_us
            self.compid = compid
        rows = decode_imu(frames, np.array([i], dtype=np.int64))
        if compid == self.compid and rows.valid[0]:
            self._seen.setdefault(int(rows.msgid[0]), int(rows.imu_id[0]))
        waited = received_us - self.first_us > CHOICE_US
        if self._seen and (PREFERENCE[0] in self._seen or waited):
            best = min(self._seen, key=PREFERENCE.index)
            self.chosen = (best, self._seen[best])
            return True
        self._dropped["IMU not chosen yet"] += 1
        return False

    def sample(self, frames: Frames, i: int) -> Samples | None:
        """The usable sample in IMU packet i, or None: `samples` of one packet, by the decoder for one."""
        assert self.chosen is not None
        msgid, imu_id = self.chosen
        if int(frames.msgid[i]) != msgid or int(frames.compid[i]) != self.compid:
            return None
        message = decode(frames, i)
        if not isinstance(message, ImuMessage):
            self._dropped["IMU invalid"] += 1
            return None
        if message.imu_id != imu_id:
            self._dropped["IMU of another id"] += 1
            return None
        received_us = frames.t_us[i : i + 1]
        self.newest_us = int(received_us[0])
        at = np.array([i], dtype=np.int64)
        return Samples(
            at,
            np.array([message.stamp_us], dtype=np.int64),
            message.accel_b[np.newaxis],
            message.gyro_b[np.newaxis],
            received_us,
            decode_fields(frames, at) if self._with_field else None,
        )

    def samples(self, frames: Frames, at: IntArray) -> Samples:
        """The usable samples of the chosen message and sensor among the IMU packets `at` (N,)."""
        assert self.chosen is not None
        msgid, imu_id = self.chosen
        at = at[(frames.msgid[at] == msgid) & (frames.compid[at] == self.compid)]
        rows = decode_imu(frames, at)
        usable = rows.valid & (rows.imu_id == imu_id)
        stamp_us, accel_b, gyro_b = rows.stamp_us, rows.accel_b, rows.gyro_b
        if not usable.all():
            invalid = int((~rows.valid).sum())
            self._dropped["IMU invalid"] += invalid
            self._dropped["IMU of another id"] += len(rows) - invalid - int(usable.sum())
            at, stamp_us = at[usable], stamp_us[usable]
            accel_b, gyro_b = accel_b[usable], gyro_b[usable]
        received_us = frames.t_us[at]
        if len(at):
            self.newest_us = int(received_us[-1])
        field = decode_fields(frames, at) if self._with_field else None
        return Samples(at, stamp_us, accel_b, gyro_b, received_us, field)
