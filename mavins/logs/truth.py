"""The truth that a simulator left in a log, for evaluation only: no estimator reads it.

PX4 and our simulator send HIL_STATE_QUATERNION with boot microseconds; ArduPilot sends SIM_STATE
without a stamp, which belongs to the RAW_IMU of that vehicle just before it in the stream.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.mavlink.codec.decode import FIRST_UNIX_US
from mavins.mavlink.codec.fields import fields_of
from mavins.mavlink.codec.framing import Frames
from mavins.mavlink.codec.tables import payload_rows
from mavins.types import FloatArray, IntArray

_HIL_STATE_QUATERNION: Final = fields_of("HIL_STATE_QUATERNION")
_SIM_STATE: Final = fields_of("SIM_STATE")
_RAW_IMU: Final = fields_of("RAW_IMU")
_DEG_E7: Final = np.radians(1e-7)


@dataclass(frozen=True, slots=True)
class Truth:
    """N truth samples in increasing time, from messages or a file called `source`.

    `t_us` (N,) boot microseconds; `lla` (N, 3) latitude and longitude in rad, altitude in m above mean sea level;
    `v_l` (N, 3) m/s NED; `q_lb` (N, 4) unit quaternions, scalar first. What a file lacks is nan.
    """

    t_us: IntArray
    lla: FloatArray
    v_l: FloatArray
    q_lb: FloatArray
    source: str = "simulator"

    def columns(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """As `evaluation.errors.interpolate_truth` takes it."""
        return self.t_us, self.lla, self.v_l, self.q_lb

    def __len__(self) -> int:
        return len(self.t_us)


def truth_of(frames: Frames, sysid: int) -> Truth | None:
    """The truth of vehicle `sysid`, or None where the log carries none."""
    return _hil_state(frames, sysid) or _sim_state(frames, sysid)


def judge_of(truth: Truth | None, reference: Truth | None) -> Truth | None:
    """What estimates are measured against: the truth, or for want of one the log's own filter."""
    known = (judge for judge in (truth, reference) if judge is not None and len(judge) > 1)
    return next(known, None)


def joined(parts: Sequence[Truth]) -> Truth | None:
    """Parts of a truth, one after the other, as one; None for none."""
    if len(parts) < 2:
        return next(iter(parts), None)
    t_us, first = np.unique(np.concatenate([part.t_us for part in parts]), return_index=True)
    lla, v_l, q_lb = (
        np.concatenate([getattr(part, name) for part in parts])[first]
        for name in ("lla", "v_l", "q_lb")
    )
    return Truth(t_us, lla, v_l, q_lb, parts[0].source)


def _hil_state(frames: Frames, sysid: int) -> Truth | None:
    at = np.flatnonzero((frames.msgid == _HIL_STATE_QUATERNION.msgid) & (frames.sysid == sysid))
    if not len(at):
        return None
    rows = payload_rows(frames, at, _HIL_STATE_QUATERNION)
    return _table(
        "HIL_STATE_QUATERNION",
        rows["time_usec"].astype(np.int64),
        rows["lat"] * _DEG_E7,
        rows["lon"] * _DEG_E7,
        rows["alt"] * 1e-3,
        np.column_stack([rows["vx"], rows["vy"], rows["vz"]]) * 1e-2,
        rows["attitude_quaternion"].astype(np.float64),
    )


def _sim_state(frames: Frames, sysid: int) -> Truth | None:
    mine = frames.sysid == sysid
    at = np.flatnonzero((frames.msgid == _SIM_STATE.msgid) & mine)
    imu_at = np.flatnonzero((frames.msgid == _RAW_IMU.msgid) & mine)
    if not len(at) or not len(imu_at):
        return None
    stamps = payload_rows(frames, imu_at, _RAW_IMU)["time_usec"].astype(np.int64)
    before = np.searchsorted(imu_at, at) - 1
    at, before = at[before >= 0], before[before >= 0]
    rows = payload_rows(frames, at, _SIM_STATE)
    return _table(
        "SIM_STATE",
        stamps[before],
        rows["lat_int"] * _DEG_E7,
        rows["lon_int"] * _DEG_E7,
        rows["alt"].astype(np.float64),
        np.column_stack([rows["vn"], rows["ve"], rows["vd"]]).astype(np.float64),
        np.column_stack([rows["q1"], rows["q2"], rows["q3"], rows["q4"]]).astype(np.float64),
    )


def _table(
    source: str,
    t_us: IntArray,
    lat: FloatArray,
    lon: FloatArray,
    alt: FloatArray,
    v_l: FloatArray,
    q_lb: FloatArray,
) -> Truth | None:
    """The table without the rows that cannot be true, in increasing time, one row per stamp."""
    norm = np.linalg.norm(q_lb, axis=1)
    usable = (t_us > 0) & (t_us < FIRST_UNIX_US) & (abs(norm - 1.0) < 0.1) & np.isfinite(alt)
    usable &= np.isfinite(v_l).all(axis=1) & ((lat != 0.0) | (lon != 0.0))
    _, first = np.unique(t_us[usable], return_index=True)
    kept = np.flatnonzero(usable)[first]
    if not len(kept):
        return None
    unit = q_lb[kept] / norm[kept, None]
    lla = np.column_stack([lat, lon, alt])[kept]
    return Truth(t_us[kept], lla, v_l[kept], unit, source)
