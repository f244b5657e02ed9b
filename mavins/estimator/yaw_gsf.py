"""Yaw from motion: a Gaussian sum of small filters, each with its own guess of the yaw.

The gyro carries one attitude q_hb along, in a frame h that is level but points anywhere. Its yaw psi from north is
what the filters disagree on. Each has x = [v_n, v_e, psi, phi_x, phi_y] with phi the tilt error of h, and is taken
from one GNSS velocity to the next by the specific force F = (integral of C_hb f dt) over the time between:

    v <- v + Rz(psi) d,    d = [F_x + phi_y F_z, F_y - phi_x F_z]

A weight is its filter's likelihood. Source: Alspach and Sorenson (1972).
Theory: docs/theory/yaw_without_magnetometer.md.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mavins.nav.kernels import kernel
from mavins.nav.so3 import cross, exponential, product, wrap_pi, write_dcm
from mavins.types import FloatArray, IntArray

HYPOTHESES: Final = 8
STATES: Final = 5
SPACING: Final = 2.0 * math.pi / HYPOTHESES
TILT_SIGMA: Final = 0.1
"""What is not known of the first levelling (rad): an acceleration of 1 m/s^2."""
OUTLIER: Final = 30.0
"""The NIS of two rows above which no filter believes a velocity."""
SMOOTHING: Final = 0.1
HOPELESS: Final = 12.0
"""The mean NIS of two rows, of so large a share of the newest, above which all begins anew."""
LEAST: Final = -40.0
"""Logarithm of the smallest weight: a filter that was wrong once may come back."""


@kernel
def advance(
    q_hb: FloatArray,
    force_h: FloatArray,
    u: FloatArray,
    b_g: FloatArray,
    start_us: int,
    t_us: IntArray,
    imu: FloatArray,
    until_us: int,
) -> None:
    """Turn q_hb (4,) and add to F = force_h (3,) in m/s from `start_us` to `until_us`, in place.

    `u` (6,) is the reading [gyro_b, accel_b] at the start, then at the end; rows as in Filter.walk: the last one may
    lie beyond the end. Readings are taken as linear between rows, the attitude in the middle of each interval.
    """
    C = np.empty((3, 3))
    mean = np.empty(6)
    t0 = start_us
    for k in range(len(t_us)):
        t1, s = t_us[k], 1.0
        if t1 > until_us:
            s = (until_us - t0) / (t1 - t0)
            t1 = until_us
        dt = (t1 - t0) * 1e-6
        for j in range(6):
            reading = u[j] + s * (imu[k, j] - u[j])
            mean[j] = 0.5 * (u[j] + reading)
            u[j] = reading
        half = exponential(
            0.5 * dt * (mean[0] - b_g[0]),
            0.5 * dt * (mean[1] - b_g[1]),
            0.5 * dt * (mean[2] - b_g[2]),
        )
        q = product((q_hb[0], q_hb[1], q_hb[2], q_hb[3]), half)
        write_dcm(C, q)
        for i in range(3):
            force_h[i] += dt * (C[i, 0] * mean[3] + C[i, 1] * mean[4] + C[i, 2] * mean[5])
        _put(q_hb, product(q, half))
        t0 = t1


@kernel
def _put(q_hb: FloatArray, q: tuple[float, float, float, float]) -> None:
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q_hb[i] = q[i] / n


@kernel
def spread(x: FloatArray, P: FloatArray, log_w: FloatArray, v: FloatArray, sigma: float) -> None:
    """Begin with all yaws alike: filters x (N, 5), P (N, 5, 5) evenly around, at a velocity v (2,) with its sigma."""
    for i in range(x.shape[0]):
        log_w[i] = -math.log(x.shape[0])
        for j in range(STATES):
            x[i, j] = 0.0
            for k in range(STATES):
                P[i, j, k] = 0.0
        x[i, 0], x[i, 1] = v[0], v[1]
        x[i, 2] = wrap_pi(i * SPACING)
        P[i, 0, 0] = P[i, 1, 1] = sigma * sigma
        P[i, 2, 2] = 0.25 * SPACING * SPACING
        P[i, 3, 3] = P[i, 4, 4] = TILT_SIGMA * TILT_SIGMA


@kernel
def predict(x: FloatArray, P: FloatArray, force_h: FloatArray, Q: FloatArray) -> None:
    """Take one filter, x (5,) and P (5, 5), through F = force_h (3,); Q (3,) is added to velocity, yaw and tilt.

    Noise in d looks like motion, and a filter that takes it at face value becomes sure of its yaw in a hover; so
    the Jacobian to psi is weighted by the share of d^2 that is not its own variance.
    """
    f = force_h[2]
    d0 = force_h[0] + x[4] * f
    d1 = force_h[1] - x[3] * f
    square = d0 * d0 + d1 * d1
    share = square / (square + 2.0 * Q[0] + f * f * (P[3, 3] + P[4, 4]))
    c, s = math.cos(x[2]), math.sin(x[2])
    x[0] += c * d0 - s * d1
    x[1] += s * d0 + c * d1
    J = np.empty((2, 3))
    J[0, 0], J[1, 0] = -share * (s * d0 + c * d1), share * (c * d0 - s * d1)
    J[0, 1], J[0, 2] = s * f, c * f
    J[1, 1], J[1, 2] = -c * f, s * f
    for j in range(STATES):
        for i in range(2):
            P[i, j] += J[i, 0] * P[2, j] + J[i, 1] * P[3, j] + J[i, 2] * P[4, j]
    for j in range(STATES):
        for i in range(2):
            P[j, i] += J[i, 0] * P[j, 2] + J[i, 1] * P[j, 3] + J[i, 2] * P[j, 4]
    for j in range(STATES):
        P[j, j] += Q[0] if j < 2 else Q[1] if j == 2 else Q[2]


@kernel
def innovate(
    x: FloatArray, P: FloatArray, z: FloatArray, R: float, lever_h: FloatArray, out: FloatArray
) -> None:
    """What z (2,), the antenna's velocity with the variance R, says to one filter.

    `out` (22,): H P (2, 5), S^-1 H P (2, 5), NIS, log det S. h = v + Rz(psi) lever_h, with lever_h (2,) the velocity of
    the antenna about the IMU.
    """
    c, s = math.cos(x[2]), math.sin(x[2])
    l0, l1 = c * lever_h[0] - s * lever_h[1], s * lever_h[0] + c * lever_h[1]
    r0, r1 = z[0] - x[0] - l0, z[1] - x[1] - l1
    for j in range(STATES):
        out[j] = P[0, j] - l1 * P[2, j]
        out[5 + j] = P[1, j] + l0 * P[2, j]
    S00 = out[0] - l1 * out[2] + R
    S11 = out[6] + l0 * out[7] + R
    S01 = out[1] + l0 * out[2]
    det = S00 * S11 - S01 * S01
    for j in range(STATES):
        out[10 + j] = (S11 * out[j] - S01 * out[5 + j]) / det
        out[15 + j] = (S00 * out[5 + j] - S01 * out[j]) / det
    out[20] = (S11 * r0 * r0 - 2.0 * S01 * r0 * r1 + S00 * r1 * r1) / det
    out[21] = math.log(det)
    for j in range(STATES):
        x[j] += out[10 + j] * r0 + out[15 + j] * r1


@kernel
def fuse(
    x: FloatArray,
    P: FloatArray,
    log_w: FloatArray,
    q_hb: FloatArray,
    force_h: FloatArray,
    Q: FloatArray,
    z: FloatArray,
    R: float,
    lever_h: FloatArray,
) -> float:
    """Predict all filters to a GNSS velocity z (2,) and weigh them by it; the NIS that the sum gives it.

    Their mean tilt error goes into q_hb. A velocity that no filter believes is left out.
    """
    n = x.shape[0]
    out = np.empty((n, 22))
    updated = np.empty((n, STATES))
    best = math.inf
    for i in range(n):
        predict(x[i], P[i], force_h, Q)
        for j in range(STATES):
            updated[i, j] = x[i, j]
        innovate(updated[i], P[i], z, R, lever_h, out[i])
        best = min(best, out[i, 20])
    if not best <= OUTLIER:
        return best
    top = -math.inf
    for i in range(n):
        log_w[i] -= 0.5 * (out[i, 20] + out[i, 21])
        top = max(top, log_w[i])
        for j in range(STATES):
            x[i, j] = updated[i, j]
            for k in range(STATES):
                P[i, j, k] -= out[i, j] * out[i, 10 + k] + out[i, 5 + j] * out[i, 15 + k]
        x[i, 2] = wrap_pi(x[i, 2])
        for j in range(STATES):
            for k in range(j):
                P[i, j, k] = P[i, k, j] = 0.5 * (P[i, j, k] + P[i, k, j])
    total = 0.0
    for i in range(n):
        log_w[i] = max(log_w[i] - top, LEAST)
        total += math.exp(log_w[i])
    nis = tilt_x = tilt_y = 0.0
    for i in range(n):
        log_w[i] -= math.log(total)
        w = math.exp(log_w[i])
        nis += w * out[i, 20]
        tilt_x += w * x[i, 3]
        tilt_y += w * x[i, 4]
    for i in range(n):
        x[i, 3] -= tilt_x
        x[i, 4] -= tilt_y
    _put(q_hb, product(exponential(tilt_x, tilt_y, 0.0), (q_hb[0], q_hb[1], q_hb[2], q_hb[3])))
    return nis


@kernel
def follow(
    x: FloatArray,
    P: FloatArray,
    log_w: FloatArray,
    q_hb: FloatArray,
    force_h: FloatArray,
    u: FloatArray,
    b_g: FloatArray,
    lever_b: FloatArray,
    variances: FloatArray,
    clock: IntArray,
    nis: float,
    t_us: IntArray,
    imu: FloatArray,
    fix_us: IntArray,
    fixes: FloatArray,
) -> float:
    """Go on to each of the velocities `fixes` (K, 3) in turn and fuse it; returns the running mean `nis`.

    A velocity is v_n, v_e, sigma, valid at `fix_us` (K,). `clock` (2,) is where the attitude and the filters are (us);
    what is older is left out, and the IMU rows are those after clock[0]. `variances` (2,) is what a second adds to a
    velocity and to an angle. Where the NIS is hopeless, all begins anew.
    """
    C_hb = np.empty((3, 3))
    lever_h = np.empty(2)
    Q = np.empty(3)
    first = 0
    for k in range(len(fix_us)):
        if fix_us[k] <= clock[0]:
            continue
        end = first
        while end < len(t_us) and t_us[end] < fix_us[k]:
            end += 1
        rows = slice(first, end + 1)
        advance(q_hb, force_h, u, b_g, clock[0], t_us[rows], imu[rows], fix_us[k])
        clock[0] = fix_us[k]
        first = end + 1 if end < len(t_us) and t_us[end] == fix_us[k] else end
        dt = (clock[0] - clock[1]) * 1e-6
        Q[0], Q[1], Q[2] = variances[0] * dt, variances[1] * dt, variances[1] * dt
        write_dcm(C_hb, (q_hb[0], q_hb[1], q_hb[2], q_hb[3]))
        swing = cross(u[:3] - b_g, lever_b)
        for i in range(2):
            lever_h[i] = C_hb[i, 0] * swing[0] + C_hb[i, 1] * swing[1] + C_hb[i, 2] * swing[2]
        sigma = fixes[k, 2]
        one = fuse(x, P, log_w, q_hb, force_h, Q, fixes[k, :2], sigma * sigma, lever_h)
        nis += SMOOTHING * (one - nis)
        if nis > HOPELESS:
            spread(x, P, log_w, fixes[k, :2], sigma)
            nis = 0.0
        for i in range(3):
            force_h[i] = 0.0
        clock[1] = clock[0]
    return nis


@kernel
def moments(x: FloatArray, P: FloatArray, log_w: FloatArray) -> tuple[float, float, float]:
    """(psi, its sigma, the sigma of the tilt) of the whole sum, in rad."""
    c = s = 0.0
    for i in range(x.shape[0]):
        w = math.exp(log_w[i])
        c += w * math.cos(x[i, 2])
        s += w * math.sin(x[i, 2])
    psi = math.atan2(s, c)
    variance = tilt = 0.0
    for i in range(x.shape[0]):
        w = math.exp(log_w[i])
        apart = wrap_pi(x[i, 2] - psi)
        variance += w * (P[i, 2, 2] + apart * apart)
        tilt += w * 0.5 * (P[i, 3, 3] + P[i, 4, 4] + x[i, 3] * x[i, 3] + x[i, 4] * x[i, 4])
    return psi, math.sqrt(variance), math.sqrt(tilt)
