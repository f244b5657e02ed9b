"""The first attitude: roll and pitch from gravity, yaw from a heading, and what is not known about them.

The mean specific force f over a window is C_bn (a_n - g_n) + b_a, with a_n from GNSS when the vehicle moves. With
the yaw given, pitch and roll follow in closed form. An accelerometer bias tilts the result by f x b_a / |f|^2, so
tilt and bias start out correlated; leaving that out would make the filter too sure of both.
Source: Groves (2013), section 5.6. Theory: docs/theory/alignment.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavins.nav.layout import (
    B_A,
    B_BARO,
    B_G,
    B_M,
    CANONICAL_SIZE,
    G_N,
    L_B,
    P_N,
    TAU,
    THETA_B,
    V_N,
    X_BG,
    X_L,
    X_P,
    X_Q,
    X_SIZE,
    X_TAU,
    X_V,
    Layout,
)
from mavins.nav.so3 import euler_jacobian, euler_to_quat, quat_to_dcm, quat_to_euler, skew
from mavins.types import FloatArray


def level(f_b: FloatArray, push_n: FloatArray, yaw: float) -> FloatArray:
    """q_nb (4,) with C_bn push_n along f_b and the given yaw; push_n = a_n - g_n in m/s^2 (standing: -g_n).

    In the frame turned by yaw, s = Rz(yaw)^T push_n; then f_x = s_x cos(pitch) - s_z sin(pitch), and roll turns what is
    left of s onto (f_y, f_z). Where noise makes |f_x| too large for s, the pitch is the nearest possible.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    x = c * push_n[0] + s * push_n[1]
    y = -s * push_n[0] + c * push_n[1]
    z = float(push_n[2])
    scale = float(np.linalg.norm(push_n) / np.linalg.norm(f_b))
    f = f_b * scale
    h = math.hypot(x, z)
    # x cos(p) - z sin(p) = h cos(p + a) with a = atan2(z, x): of both solutions the one nearer to level
    a = math.atan2(z, x)
    b = math.acos(min(1.0, max(-1.0, float(f[0]) / h)))
    pitch = min((math.remainder(b - a, 2 * math.pi), math.remainder(-b - a, 2 * math.pi)), key=abs)
    z1 = math.sin(pitch) * x + math.cos(pitch) * z
    roll = math.atan2(float(f[1]), float(f[2])) - math.atan2(y, z1)
    return euler_to_quat(math.remainder(roll, 2 * math.pi), pitch, yaw)


@dataclass(frozen=True, slots=True)
class Start:
    """What the first state is made from.

    `accel_b` (3,) is the mean over the window; `push_n` (3,) is a_n - g_n; position, velocity and their (3, 3)
    noise covariances are in n. Sigmas in rad, rad/s, m/s^2; `b_g` (3,) with `sigma_b_g` is the gyro bias. Where the
    attitude `q_nb` (4,) is known, nothing is levelled. Where the yaw is that of a magnetic field, `yaw_by_mag` (3,) is
    what a bias of it, along the axes of n, adds to the yaw.
    """

    accel_b: FloatArray
    push_n: FloatArray
    yaw_n: float
    p_n: FloatArray
    R_p: FloatArray
    v_n: FloatArray
    R_v: FloatArray
    b_g: FloatArray
    sigma_b_g: float
    sigma_b_a: float
    sigma_tilt: float
    sigma_yaw: float
    lever_b: FloatArray
    sigma_lever: float = 0.0
    delay: float = 0.0
    sigma_delay: float = 0.0
    sigma_baro: float = 0.0
    sigma_mag: float = 0.0
    sigma_gravity: float = 0.0
    yaw_by_mag: FloatArray | None = None
    q_nb: FloatArray | None = None


def initial_state(start: Start, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """(x (26,), P over the errors of the layout) of the first state; the antenna's position is brought to the IMU."""
    x = np.zeros(X_SIZE)
    known = start.q_nb
    x[X_Q] = level(start.accel_b, start.push_n, start.yaw_n) if known is None else known
    C = quat_to_dcm(x[X_Q])
    x[X_P] = start.p_n - C @ start.lever_b
    x[X_V] = start.v_n
    x[X_BG] = start.b_g
    x[X_L] = start.lever_b
    x[X_TAU] = start.delay
    P = np.zeros((CANONICAL_SIZE, CANONICAL_SIZE))
    P[L_B, L_B] = np.eye(3) * start.sigma_lever**2
    P[TAU, TAU] = start.sigma_delay**2
    P[B_BARO, B_BARO] = start.sigma_baro**2
    P[B_M, B_M] = np.eye(3) * start.sigma_mag**2
    P[G_N, G_N] = np.eye(2) * start.sigma_gravity**2
    P[P_N, P_N] = start.R_p
    P[V_N, V_N] = start.R_v
    P[B_G, B_G] = np.eye(3) * start.sigma_b_g**2
    P[B_A, B_A] = np.eye(3) * start.sigma_b_a**2

    roll, pitch, _ = quat_to_euler(x[X_Q])
    yaw_row = euler_jacobian(roll, pitch)[2]
    down_b = C[2]
    # levelling errors turn about horizontal axes of b and leave the yaw as it was given
    keep_yaw = np.eye(3) - np.outer(down_b, yaw_row)
    J = keep_yaw @ skew(start.accel_b) / float(start.accel_b @ start.accel_b)
    across = keep_yaw @ (np.eye(3) - np.outer(down_b, down_b))
    P[THETA_B, THETA_B] = (
        J @ J.T * start.sigma_b_a**2
        + across @ across.T * start.sigma_tilt**2
        + np.outer(down_b, down_b) * start.sigma_yaw**2
        + np.eye(3) * 1e-10
    )
    P[THETA_B, B_A] = J * start.sigma_b_a**2
    P[B_A, THETA_B] = P[THETA_B, B_A].T
    if "b_m" in layout.blocks and start.yaw_by_mag is not None:
        _correlate(P, B_M, -np.outer(down_b, start.yaw_by_mag @ C), start.sigma_mag)
    if "g_n" in layout.blocks:
        # levelled is what lies along gravity as it is
        _correlate(P, G_N, keep_yaw @ C.T[:, :2], start.sigma_gravity)
    if "l_b" in layout.blocks:
        # the position of the IMU is as little known as the way to the antenna
        P[P_N, P_N] += start.sigma_lever**2 * np.eye(3)
        P[P_N, L_B] = -C * start.sigma_lever**2
        P[L_B, P_N] = P[P_N, L_B].T
    return x, P[np.ix_(layout.columns, layout.columns)]


def _correlate(P: FloatArray, block: slice, J: FloatArray, sigma: float) -> None:
    """Let the attitude have an error J d (3,) more, of the error d of a block with this sigma."""
    P[THETA_B, THETA_B] += J @ J.T * sigma**2
    P[THETA_B, block] = J * sigma**2
    P[block, THETA_B] = P[THETA_B, block].T
