"""Errors of estimates against a truth: position in metres north, east and down, velocity, and Euler angles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mavins.nav.earth import dcm_ne, lla_to_ecef
from mavins.nav.kernels import kernel
from mavins.nav.so3 import quat_to_euler, wrap_pi
from mavins.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors at N instants: `pos` (N, 3) m and `vel` (N, 3) m/s NED, `att` (N, 3) roll, pitch, yaw in rad."""

    t_us: IntArray
    pos: FloatArray
    vel: FloatArray
    att: FloatArray

    def __len__(self) -> int:
        return len(self.t_us)

    def summary(self) -> dict[str, Any]:
        """RMS and maximum per axis; attitude in degrees. Instants without a truth are nan, and not counted."""
        result: dict[str, Any] = {"instants": len(self.t_us)}
        columns = {"pos_m": self.pos, "vel_m_s": self.vel, "att_deg": np.degrees(self.att)}
        known = {k: v[np.isfinite(v).all(axis=1)] for k, v in columns.items()}
        if any(len(v) for v in known.values()):
            result["rms"] = {
                k: np.sqrt(np.mean(v**2, axis=0)).tolist() for k, v in known.items() if len(v)
            }
            result["max"] = {
                k: np.max(np.abs(v), axis=0).tolist() for k, v in known.items() if len(v)
            }
        return result


def interpolate_truth(
    at_us: IntArray, t_us: IntArray, lla: FloatArray, v_l: FloatArray, q_lb: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Truth (lat, lon, alt (N, 3), v_l (N, 3), q_lb (N, 4)) at other instants, and which lie inside it.

    Position by the cubic that meets position and velocity at both ends, velocity linear, attitude by the normalized
    chord. An instant between truth samples more than 0.2 s apart has none; what a truth sample lacks is nan.
    """
    k = np.clip(np.searchsorted(t_us, at_us, side="right") - 1, 0, len(t_us) - 2)
    step = (t_us[k + 1] - t_us[k]) * 1e-6
    s = ((at_us - t_us[k]) * 1e-6 / step)[:, None]
    inside = (at_us >= t_us[0]) & (at_us <= t_us[-1]) & (step <= 0.2)
    # the velocity per unit of (lat, lon, alt): the positions' own scale over a step is accurate enough
    linear = lla[k] + s * (lla[k + 1] - lla[k])
    bend = 0.5 * s * (1.0 - s) * step[:, None] * step[:, None]
    acceleration = np.nan_to_num((v_l[k + 1] - v_l[k]) / step[:, None])
    scale = np.column_stack(
        [
            np.full(len(k), 1.0 / 6.37e6),
            1.0 / (6.37e6 * np.maximum(np.cos(lla[k, 0]), 1e-9)),
            np.full(len(k), -1.0),
        ]
    )
    position = linear - bend * acceleration * scale
    velocity = v_l[k] + s * (v_l[k + 1] - v_l[k])
    flip = np.where(np.sum(q_lb[k] * q_lb[k + 1], axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    q = q_lb[k] + s * (flip * q_lb[k + 1] - q_lb[k])
    return position, velocity, q / np.linalg.norm(q, axis=1, keepdims=True), inside


def errors_against(
    at_us: IntArray,
    lla: FloatArray,
    v_l: FloatArray,
    euler: FloatArray,
    truth: tuple[IntArray, FloatArray, FloatArray, FloatArray],
) -> Errors:
    """Errors of estimates (lat, lon, alt (N, 3), v_l (N, 3), Euler angles (N, 3)) against a truth.

    The truth is (t_us, lla, v_l, q_lb), as for `interpolate_truth`.
    """
    true_lla, true_v, true_q, inside = interpolate_truth(at_us, *truth)
    solid = [np.ascontiguousarray(a) for a in (lla, euler, true_lla, true_q)]
    pos, att = _position_and_attitude(*solid)
    return Errors(at_us[inside], pos[inside], (v_l - true_v)[inside], att[inside])


@kernel
def _position_and_attitude(
    lla: FloatArray, euler: FloatArray, true_lla: FloatArray, true_q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Position errors (N, 3) in the true place's north, east, down and wrapped Euler angle errors (N, 3)."""
    pos = np.empty(lla.shape)
    att = np.empty(lla.shape)
    for k in range(lla.shape[0]):
        at = lla_to_ecef(lla[k, 0], lla[k, 1], lla[k, 2])
        true_at = lla_to_ecef(true_lla[k, 0], true_lla[k, 1], true_lla[k, 2])
        C_le = dcm_ne(true_lla[k, 0], true_lla[k, 1])
        true_euler = quat_to_euler(true_q[k])
        for i in range(3):
            pos[k, i] = 0.0
            for j in range(3):
                pos[k, i] += C_le[i, j] * (at[j] - true_at[j])
            att[k, i] = wrap_pi(euler[k, i] - true_euler[i])
    return pos, att
