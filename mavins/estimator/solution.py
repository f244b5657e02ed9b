"""From a filter's state to what users read: geodetic position, local level velocity and attitude, and their sigmas.

Theory: docs/theory/outputs.md.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mavins.filters.base import FilterState
from mavins.nav.earth import TangentFrame, dcm_ln, ecef_of, ecef_to_lla
from mavins.nav.kernels import kernel
from mavins.nav.layout import (
    B_BARO,
    B_M,
    G_N,
    L_B,
    TAU,
    X_BARO,
    X_BM,
    X_G,
    X_L,
    X_TAU,
    Layout,
)
from mavins.nav.so3 import dcm_to_quat, euler_jacobian, quat_mul, quat_to_euler
from mavins.types import FloatArray, Health, NavSolution

LLA: Final = slice(0, 3)
P_N: Final = slice(3, 6)
V_L: Final = slice(6, 9)
EULER: Final = slice(9, 12)
Q_LB: Final = slice(12, 16)
SD_P: Final = slice(16, 19)
SD_V: Final = slice(19, 22)
SD_EULER: Final = slice(22, 25)
B_G: Final = slice(25, 28)
B_A: Final = slice(28, 31)
WIDTH: Final = 31
"""Places in a described row: rad, m, m/s; position sigmas in n, velocity and attitude in l."""


@kernel
def describe(
    x: FloatArray, P: FloatArray, r0_e: FloatArray, C_ne: FloatArray, out: FloatArray
) -> None:
    """Write rows (N, 31) for states x (N, 26) with covariances P (N, 15, 15).

    A loop and not array arithmetic: a row must not depend, in its last bit, on how many rows come with it.
    """
    for k in range(x.shape[0]):
        lla = ecef_to_lla(ecef_of(x[k, 0:3], r0_e, C_ne))
        C_ln = dcm_ln(lla[0], lla[1], C_ne)
        q = quat_mul(dcm_to_quat(C_ln), x[k, 6:10])
        euler = quat_to_euler(q)
        E = euler_jacobian(euler[0], euler[1])
        for i in range(3):
            out[k, i] = lla[i]
            out[k, 3 + i] = x[k, i]
            out[k, 6 + i] = C_ln[i, 0] * x[k, 3] + C_ln[i, 1] * x[k, 4] + C_ln[i, 2] * x[k, 5]
            out[k, 9 + i] = euler[i]
            out[k, 16 + i] = math.sqrt(P[k, i, i])
            var_v = 0.0
            var_e = 0.0
            for a in range(3):
                for b in range(3):
                    var_v += C_ln[i, a] * P[k, 3 + a, 3 + b] * C_ln[i, b]
                    var_e += E[i, a] * P[k, 6 + a, 6 + b] * E[i, b]
            out[k, 19 + i] = math.sqrt(max(var_v, 0.0))
            out[k, 22 + i] = math.sqrt(max(var_e, 0.0))
            out[k, 25 + i] = x[k, 10 + i]
            out[k, 28 + i] = x[k, 13 + i]
        for i in range(4):
            out[k, 12 + i] = q[i]


def solution_of(
    state: FilterState, layout: Layout, frame: TangentFrame, health: Health, reset_counter: int
) -> NavSolution:
    """The navigation solution of one state."""
    sigmas = layout.sigmas(state.P)
    row = np.empty((1, WIDTH))
    P = state.P[:15, :15].copy()
    describe(state.x[np.newaxis], P[np.newaxis], frame.r0_e, frame.C_ne, row)
    r = row[0]
    x, u = state.x, state.u
    return NavSolution(
        t_us=state.t_us,
        lat=float(r[0]),
        lon=float(r[1]),
        alt=float(r[2]),
        p_n=r[P_N],
        v_n=x[3:6].copy(),
        q_nb=x[6:10].copy(),
        v_l=r[V_L],
        q_lb=r[Q_LB],
        roll=float(r[9]),
        pitch=float(r[10]),
        yaw=float(r[11]),
        w_b=u[0:3] - x[10:13],
        f_b=u[3:6] - x[13:16],
        b_g=r[B_G],
        b_a=r[B_A],
        P=P,
        sd_euler=r[SD_EULER],
        l_b=x[X_L].copy(),
        sd_l_b=sigmas[L_B],
        tau=float(x[X_TAU]),
        sd_tau=float(sigmas[TAU][0]),
        b_baro=float(x[X_BARO]),
        sd_b_baro=float(sigmas[B_BARO][0]),
        b_m=x[X_BM].copy(),
        sd_b_m=sigmas[B_M],
        g_n=x[X_G].copy(),
        sd_g_n=sigmas[G_N],
        health=health,
        reset_counter=reset_counter,
    )
