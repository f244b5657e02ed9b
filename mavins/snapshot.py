"""From estimates and statistics to what the live status shows."""

from __future__ import annotations

import math

from mavins.estimator.statistics import AidingStatistics
from mavins.status import AidingStatus, EstimateStatus, Pair, Vector
from mavins.types import FloatArray, NavSolution


def _vector(values: FloatArray) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def _pair(values: FloatArray) -> Pair:
    x, y = values.tolist()
    return (x, y)


def estimate_status(solution: NavSolution) -> EstimateStatus:
    """The estimate with its 1-sigmas."""
    sd = [math.sqrt(max(0.0, float(solution.P[i, i]))) for i in range(6)]
    return EstimateStatus(
        lat_deg=math.degrees(solution.lat),
        lon_deg=math.degrees(solution.lon),
        alt=solution.alt,
        p_n=_vector(solution.p_n),
        sd_p=(sd[0], sd[1], sd[2]),
        v_l=_vector(solution.v_l),
        sd_v=(sd[3], sd[4], sd[5]),
        attitude=(solution.roll, solution.pitch, solution.yaw),
        sd_attitude=_vector(solution.sd_euler),
        lever_arm=_vector(solution.l_b) if solution.sd_l_b.any() else None,
        sd_lever_arm=_vector(solution.sd_l_b) if solution.sd_l_b.any() else None,
        delay=solution.tau if solution.sd_tau else None,
        sd_delay=solution.sd_tau if solution.sd_tau else None,
        baro_bias=solution.b_baro if solution.sd_b_baro else None,
        sd_baro_bias=solution.sd_b_baro if solution.sd_b_baro else None,
        mag_bias=_vector(solution.b_m) if solution.sd_b_m.any() else None,
        sd_mag_bias=_vector(solution.sd_b_m) if solution.sd_b_m.any() else None,
        gravity=_pair(solution.g_n) if solution.sd_g_n.any() else None,
        sd_gravity=_pair(solution.sd_g_n) if solution.sd_g_n.any() else None,
    )


def aiding_status(statistics: AidingStatistics) -> AidingStatus:
    """Counts and innovation statistics of one aiding."""
    statistics.fold()
    if not statistics.accepted:
        return AidingStatus(0, dict(statistics.rejected))
    mean = statistics.nis_sum / statistics.accepted
    expected = statistics.rows / statistics.accepted
    return AidingStatus(
        fused=statistics.accepted,
        rejected=dict(statistics.rejected),
        nis_mean=mean,
        nis_expected=expected,
        sigma_ratio=math.sqrt(max(0.0, mean / expected)),
    )
