"""What a vehicle's autopilot says of itself in a telemetry log, as a reference: another filter's word, no truth."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavins.evaluation.errors import interpolate_truth
from mavins.logs.truth import Truth
from mavins.mavlink.codec import IMU_KINDS, Frames, fields_of, payload_rows
from mavins.mavlink.sources import ARDUPILOT, PX4
from mavins.nav.rotations import euler_to_quats
from mavins.types import FloatArray, IntArray

NAME: Final = "autopilot"
_HEARTBEAT: Final = fields_of("HEARTBEAT")
_ATTITUDE: Final = fields_of("ATTITUDE")
_POSITION: Final = fields_of("GLOBAL_POSITION_INT")


class AutopilotReference:
    """Gathers ATTITUDE and GLOBAL_POSITION_INT of a PX4 or ArduPilot, block by block."""

    def __init__(self) -> None:
        self._compid: int | None = None
        self._is_filter = False
        self._attitude: list[tuple[IntArray, FloatArray]] = []
        self._position: list[tuple[IntArray, FloatArray]] = []

    def see(self, frames: Frames, sysid: int) -> None:
        """Look at a block for what the component that sends the IMU says."""
        mine = frames.sysid == sysid
        if self._compid is None:
            imu_at = np.flatnonzero(mine & np.isin(frames.msgid, list(IMU_KINDS)))
            if not len(imu_at):
                return
            self._compid = int(frames.compid[imu_at[0]])
        mine &= frames.compid == self._compid
        if not self._is_filter:
            at = np.flatnonzero(mine & (frames.msgid == _HEARTBEAT.msgid))
            kinds = payload_rows(frames, at, _HEARTBEAT)["autopilot"]
            self._is_filter = bool(np.isin(kinds, (ARDUPILOT, PX4)).any())
        at = np.flatnonzero(mine & (frames.msgid == _ATTITUDE.msgid))
        rows = payload_rows(frames, at, _ATTITUDE)
        angles = np.column_stack([rows[name] for name in ("roll", "pitch", "yaw")])
        self._attitude.append((_boot_us(rows), angles.astype(np.float64)))
        at = np.flatnonzero(mine & (frames.msgid == _POSITION.msgid))
        rows = payload_rows(frames, at, _POSITION)
        place = np.column_stack([np.radians(rows["lat"] * 1e-7), np.radians(rows["lon"] * 1e-7)])
        velocity = np.column_stack([rows[name] for name in ("vx", "vy", "vz")]) * 1e-2
        moves = np.column_stack([place, rows["alt"] * 1e-3, velocity])
        self._position.append((_boot_us(rows), moves))

    def truth(self) -> Truth | None:
        """Attitude where it was said, and between positions not too far apart those; None where there is no filter."""
        t_us, angles = _in_order(self._attitude)
        at_us, moves = _in_order(self._position)
        usable = np.isfinite(angles).all(axis=1)
        t_us, angles = t_us[usable], angles[usable]
        if not self._is_filter or len(t_us) < 2 or len(at_us) < 2:
            return None
        moves[(moves[:, :2] == 0.0).all(axis=1)] = np.nan
        level = np.tile([1.0, 0.0, 0.0, 0.0], (len(at_us), 1))
        lla, v_l, _, inside = interpolate_truth(t_us, at_us, moves[:, :3], moves[:, 3:], level)
        outside = np.logical_not(inside)
        lla[outside] = v_l[outside] = np.nan
        return Truth(t_us, lla, v_l, euler_to_quats(angles), NAME)


def _boot_us(rows: NDArray[np.void]) -> IntArray:
    stamps: IntArray = rows["time_boot_ms"].astype(np.int64) * 1000
    return stamps


def _in_order(parts: list[tuple[IntArray, FloatArray]]) -> tuple[IntArray, FloatArray]:
    """All parts as one, by their stamps, the first of each."""
    if not parts:
        return np.empty(0, dtype=np.int64), np.empty((0, 6))
    t_us, first = np.unique(np.concatenate([t for t, _ in parts]), return_index=True)
    return t_us, np.concatenate([rows for _, rows in parts])[first]
