"""Heading: the yaw of the body's forward axis in the local level frame.

    h = yaw(C_lb),   H_theta = [0, sin(roll)/cos(pitch), cos(roll)/cos(pitch)],   residual wrapped to (-pi, pi]

Source: Sola (2017), section 4 with the Z-Y-X kinematic matrix. Theory: docs/theory/heading.md.
"""

from __future__ import annotations

import numpy as np

from mavins.aiding.base import Measurement
from mavins.nav.earth import TangentFrame, dcm_ln, ecef_of, ecef_to_lla
from mavins.nav.kernels import kernel
from mavins.nav.layout import CANONICAL_SIZE
from mavins.nav.so3 import dcm_to_quat, euler_jacobian, quat_mul, quat_to_euler, wrap_pi
from mavins.types import FloatArray, HeadingFix

NAME = "heading"
RANK = 2


@kernel
def _turn_to_level(p_n: FloatArray, parameters: FloatArray) -> FloatArray:
    """q_ln (4,), from n to the local level frame, at a point p_n (3,)."""
    r0_e, C_ne = parameters[:3], parameters[3:12].reshape(3, 3)
    lla = ecef_to_lla(ecef_of(p_n, r0_e, C_ne))
    return dcm_to_quat(dcm_ln(lla[0], lla[1], C_ne))


@kernel
def model(
    x: FloatArray, u: FloatArray, z: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual (1,) in rad and Jacobian (1, 25); `parameters` is r0_e (3), then C_ne (9, row-major).

    The local level frame is the one at x: were it found when the heading arrives, a late fix that moves the state would
    leave a trace in it that the same fix in time does not.
    """
    euler = quat_to_euler(quat_mul(_turn_to_level(x[0:3], parameters), x[6:10]))
    E = euler_jacobian(euler[0], euler[1])
    r = np.empty(1)
    r[0] = wrap_pi(z[0] - euler[2])
    H = np.zeros((1, CANONICAL_SIZE))
    for j in range(3):
        H[0, 6 + j] = E[2, j]
    return r, H


def measure(
    fix: HeadingFix, t_us: int, frame: TangentFrame, sigma: float, gate: float, quality: str = ""
) -> Measurement:
    """A heading valid at `t_us` with a 1-sigma noise in rad."""
    return Measurement(
        NAME,
        RANK,
        fix.source,
        fix.t_us,
        t_us,
        np.array([fix.yaw]),
        np.array([[sigma**2]]),
        frame.parameters,
        model,
        gate,
        quality,
    )
