"""Gravity and the local level frame along a whole trajectory: the loops over rows, compiled.

They call the kernels of mavins.nav only; the kernel cache knows those, and numba knows this file.
"""

from __future__ import annotations

import numpy as np

from mavins.nav.earth import dcm_ne, ecef_to_lla, gravity_n
from mavins.nav.kernels import kernel
from mavins.nav.so3 import dcm_to_quat, quat_mul
from mavins.types import FloatArray


@kernel
def gravity_along(p_n: FloatArray, r0_e: FloatArray, C_ne: FloatArray) -> FloatArray:
    """g_n (N, 3) in m/s^2 at the points p_n (N, 3)."""
    g_n = np.empty_like(p_n)
    for i in range(len(p_n)):
        g_n[i] = gravity_n(p_n[i], r0_e, C_ne)
    return g_n


@kernel
def to_local_level(
    r_e: FloatArray, v_n: FloatArray, q_nb: FloatArray, C_ne: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(lla, v_l, q_lb) of r_e, v_n (N, 3), q_nb (N, 4): v_l = C_ln v_n, q_lb = q(C_ln) (x) q_nb.

    lla (N, 3) in rad, rad, m; v_l (N, 3); q_lb (N, 4).
    """
    lla = np.empty_like(r_e)
    v_l = np.zeros_like(v_n)
    q_lb = np.empty_like(q_nb)
    for i in range(len(r_e)):
        lla[i] = ecef_to_lla(r_e[i])
        C_le = dcm_ne(lla[i, 0], lla[i, 1])
        C_ln = np.empty((3, 3))
        for j in range(3):
            for k in range(3):
                C_ln[j, k] = np.sum(C_le[j] * C_ne[k])
                v_l[i, j] += C_ln[j, k] * v_n[i, k]
        q_lb[i] = quat_mul(dcm_to_quat(C_ln), q_nb[i])
    return lla, v_l, q_lb
