"""Payload bytes -> SI, many packets of one message at once: what a replay spends its time on.

The same readings as the decoders of decode.py give one by one, to the last bit.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavins.mavlink.codec.checks import MAX_ACCEL, MAX_ANGLE, MAX_GYRO, STAMP_LIMIT
from mavins.mavlink.codec.decode import ACCEL_AND_GYRO, MILLI, SCALED_KINDS, SI
from mavins.mavlink.codec.fields import Fields, fields_of
from mavins.mavlink.codec.framing import Frames, gather
from mavins.mavlink.codec.messages import IMU_KINDS, ImuRows
from mavins.types import FloatArray, IntArray

_MAGNETOMETER: Final = 0x1C0


def payload_rows(frames: Frames, indices: IntArray, fields: Fields) -> NDArray[np.void]:
    """The payloads of packets `indices` (N,), all of one message, as a structured array (N,) in
    wire units.
    """
    table = np.ascontiguousarray(frames.table[2:4, indices])
    rows = gather(frames.data, table[0], table[1], fields.unpacker.size)
    return rows.view(fields.dtype)[:, 0]


def decode_imu(frames: Frames, indices: IntArray) -> ImuRows:
    """The IMU samples of packets `indices` (N,), which are all IMU messages, at once."""
    count = len(indices)
    msgid = frames.msgid[indices]
    stamp_us = np.zeros(count, np.int64)
    accel_b, gyro_b = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    imu_id = np.zeros(count, np.int64)
    valid = np.zeros(count, np.bool_)
    for kind_id in np.unique(msgid):
        kind = IMU_KINDS[int(kind_id)]
        at = np.flatnonzero(msgid == kind_id)
        rows = payload_rows(frames, indices[at], fields_of(kind))
        accel = np.column_stack([rows["xacc"], rows["yacc"], rows["zacc"]]).astype(np.float64)
        gyro = np.column_stack([rows["xgyro"], rows["ygyro"], rows["zgyro"]]).astype(np.float64)
        in_units = SI if kind == "HIGHRES_IMU" else MILLI
        accel *= in_units[0]
        gyro *= in_units[1]
        # a NaN compares as out of range
        usable = (abs(accel) <= MAX_ACCEL).all(axis=1) & (abs(gyro) <= MAX_GYRO).all(axis=1)
        if kind == "HIGHRES_IMU":
            usable &= rows["fields_updated"] & ACCEL_AND_GYRO == ACCEL_AND_GYRO
        if kind in SCALED_KINDS:
            stamp_us[at] = rows["time_boot_ms"].astype(np.int64) * 1000
            imu_id[at] = SCALED_KINDS.index(kind)
        else:
            usable &= rows["time_usec"] < STAMP_LIMIT
            stamp_us[at] = rows["time_usec"].astype(np.int64)
            imu_id[at] = rows["id"]
        accel_b[at[usable]] = accel[usable]
        gyro_b[at[usable]] = gyro[usable]
        valid[at] = usable
    return ImuRows(stamp_us, accel_b, gyro_b, msgid, imu_id, valid)


def decode_fields(frames: Frames, indices: IntArray) -> FloatArray:
    """The magnetometer readings (N, 3) in packets `indices` (N,), IMU messages of one kind, in the kind's own unit.

    A row is NaN where the packet has none: not updated in HIGHRES_IMU, or zero as from a vehicle without the sensor.
    """
    if not len(indices):
        return np.empty((0, 3))
    kind = IMU_KINDS[int(frames.msgid[indices[0]])]
    rows = payload_rows(frames, indices, fields_of(kind))
    readings = np.column_stack([rows["xmag"], rows["ymag"], rows["zmag"]]).astype(np.float64)
    none = ~np.isfinite(readings).all(axis=1) | ~readings.any(axis=1)
    if kind == "HIGHRES_IMU":
        none |= rows["fields_updated"] & _MAGNETOMETER != _MAGNETOMETER
    readings[none] = np.nan
    return readings


def decode_yaws(frames: Frames, indices: IntArray) -> FloatArray:
    """The yaws (N,) in rad of packets `indices` (N,), which are all ATTITUDE; nan where `decode` says Invalid."""
    rows = payload_rows(frames, indices, fields_of("ATTITUDE"))
    angles = np.column_stack([rows["roll"], rows["pitch"], rows["yaw"]]).astype(np.float64)
    rates = rows["rollspeed"], rows["pitchspeed"], rows["yawspeed"]
    # a NaN compares as out of range
    usable = (abs(angles) <= MAX_ANGLE).all(axis=1) & np.isfinite(rates).all(axis=0)
    yaws: FloatArray = np.where(usable, angles[:, 2], np.nan)
    return yaws
