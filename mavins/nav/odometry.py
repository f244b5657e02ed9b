"""Pose and twist, the velocity seen from the vehicle, with covariances: what odometry is made of.

Theory: docs/theory/outputs.md.
"""

from __future__ import annotations

import numpy as np

from mavins.nav.kernels import kernel
from mavins.nav.so3 import euler_jacobian, quat_to_dcm, quat_to_euler
from mavins.types import FloatArray

STATES = 12
"""p_n, v_n, theta_b and b_g: what pose and twist depend on."""


@kernel
def write_pose_and_twist(
    q_nb: FloatArray, v_n: FloatArray, P: FloatArray, v_b: FloatArray, out: FloatArray
) -> None:
    """Write v_b (3,) and, to `out` (2, 6, 6), the covariances of pose and twist: J P J^T, P (n, n), n >= 12.

    Pose: x, y, z in n (m) and roll, pitch, yaw of q_nb (rad): J = diag(I, E) over p_n and theta_b.
    Twist: the velocity in b (m/s) and the bias-corrected rates (rad/s). With v_b = C_bn v_n and the local error
    C = C^ [I + [theta]x]: d v_b = C_bn d v_n + [v_b]x theta. The rates have their bias's error; the gyro's white
    noise is not part of the state.
    """
    C = quat_to_dcm(q_nb)
    euler = quat_to_euler(q_nb)
    E = euler_jacobian(euler[0], euler[1])
    J = np.zeros((2, 6, STATES))
    for i in range(3):
        v_b[i] = C[0, i] * v_n[0] + C[1, i] * v_n[1] + C[2, i] * v_n[2]
        J[0, i, i] = 1.0
        J[1, 3 + i, 9 + i] = -1.0
        for j in range(3):
            J[0, 3 + i, 6 + j] = E[i, j]
            J[1, i, 3 + j] = C[j, i]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        J[1, i, 6 + j] = -v_b[k]
        J[1, i, 6 + k] = v_b[j]
    JP = np.empty(STATES)
    for s in range(2):
        for i in range(6):
            for b in range(STATES):
                JP[b] = 0.0
                for a in range(STATES):
                    JP[b] += J[s, i, a] * P[a, b]
            for j in range(6):
                out[s, i, j] = 0.0
                for b in range(STATES):
                    out[s, i, j] += JP[b] * J[s, j, b]
