"""Which setting is called what as a parameter: at most 16 characters, in the order in which they are listed.

A ground station keeps files of names and values, so a name never changes its meaning; new ones are added.
"""

from __future__ import annotations

from typing import Final

from mavins.estimator.reconfigure import FIXED


def _xyz(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in "XYZ")


def _rpy(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in "RPY")


NAMES: Final[dict[str, str | tuple[str, ...]]] = {
    "filter": "FILTER",
    "imu.rotation": _rpy("IMU_ROT"),
    "imu.delay": "IMU_DELAY",
    "imu.gyro_noise": "IMU_GYRO_NOISE",
    "imu.accel_noise": "IMU_ACCEL_NOISE",
    "imu.gyro_bias_walk": "IMU_GYRO_WALK",
    "imu.accel_bias_walk": "IMU_ACCEL_WALK",
    "imu.gyro_bias_sigma": "IMU_GYRO_BIAS",
    "imu.accel_bias_sigma": "IMU_ACCEL_BIAS",
    "gnss.delay": "GNSS_DELAY",
    "gnss.utc_delay": "GNSS_DELAY_UTC",
    "gnss.lever_arm": _xyz("GNSS_ARM"),
    "gnss.position_floor": "GNSS_POS_FLOOR",
    "gnss.velocity_floor": "GNSS_VEL_FLOOR",
    "gnss.rtk_position_floor": "GNSS_RTK_POS_FLR",
    "gnss.rtk_velocity_floor": "GNSS_RTK_VEL_FLR",
    "gnss.position_sigma": "GNSS_POS_SIGMA",
    "gnss.altitude_sigma": "GNSS_ALT_SIGMA",
    "gnss.velocity_sigma": "GNSS_VEL_SIGMA",
    "gnss.gate": "GNSS_GATE",
    "gnss.min_satellites": "GNSS_SATS_MIN",
    "gnss.max_sigma_h": "GNSS_HACC_MAX",
    "gnss.max_sigma_v": "GNSS_VACC_MAX",
    "gnss.max_sigma_speed": "GNSS_SACC_MAX",
    "gnss.good_fixes": "GNSS_GOOD_FIXES",
    "gnss.max_standing_speed": "GNSS_STAND_SPEED",
    "gnss.max_standing_drift": "GNSS_STAND_DRIFT",
    "gnss.reset_after": "GNSS_RESET_AFTER",
    "heading.delay": "HDG_DELAY",
    "heading.max_rate": "HDG_RATE_MAX",
    "heading.sigma_deg": "HDG_SIGMA",
    "heading.gate": "HDG_GATE",
    "heading.from_motion": "HDG_FROM_MOTION",
    "zero_velocity.enabled": "ZUPT_ENABLE",
    "zero_velocity.sigma": "ZUPT_SIGMA",
    "zero_velocity.rate_sigma": "ZUPT_RATE_SIGMA",
    "zero_velocity.gate": "ZUPT_GATE",
    "zero_velocity.gyro_limit": "ZUPT_GYRO_LIM",
    "zero_velocity.accel_limit": "ZUPT_ACCEL_LIM",
    "zero_velocity.speed_limit": "ZUPT_SPEED_LIM",
    "states.lever_arm": "STATE_ARM",
    "states.lever_arm_sigma": "STATE_ARM_SIGMA",
    "states.gnss_delay": "STATE_DELAY",
    "states.gnss_delay_sigma": "STATE_DELAY_SIG",
    "magnetometer.enabled": "MAG_ENABLE",
    "magnetometer.delay": "MAG_DELAY",
    "magnetometer.max_rate": "MAG_RATE_MAX",
    "magnetometer.sigma": "MAG_SIGMA",
    "magnetometer.gate": "MAG_GATE",
    "magnetometer.rotation": _rpy("MAG_ROT"),
    "magnetometer.hard_iron": _xyz("MAG_IRON"),
    "magnetometer.declination_deg": "MAG_DECLINATION",
    "magnetometer.inclination_deg": "MAG_INCLINATION",
    "magnetometer.date": "MAG_DATE",
    "baro.enabled": "BARO_ENABLE",
    "baro.delay": "BARO_DELAY",
    "baro.max_rate": "BARO_RATE_MAX",
    "baro.sigma": "BARO_SIGMA",
    "baro.gate": "BARO_GATE",
    "baro.drift": "BARO_DRIFT",
    "gravity_tilt.enabled": "TILT_ENABLE",
    "gravity_tilt.sigma": "TILT_SIGMA",
    "gravity_tilt.gate": "TILT_GATE",
    "gravity_tilt.accel_limit": "TILT_ACCEL_LIM",
    "gravity_tilt.gyro_limit": "TILT_GYRO_LIM",
    "nonholonomic.enabled": "NHC_ENABLE",
    "nonholonomic.lever_arm": _xyz("NHC_ARM"),
    "nonholonomic.sigma": "NHC_SIGMA",
    "nonholonomic.gate": "NHC_GATE",
    "alignment.window": "ALIGN_WINDOW",
    "alignment.heading_age": "ALIGN_HDG_AGE",
    "alignment.moving_sigma_deg": "ALIGN_TILT_SIGMA",
    "estimator.buffer": "EST_BUFFER",
    "estimator.max_gap": "EST_GAP_MAX",
    "estimator.dead_reckoning_after": "EST_DR_AFTER",
    "estimator.max_position_sigma": "EST_SIGMA_MAX",
    "filters.euler_ekf.compat": "EULER_COMPAT",
    "filters.iterated.iterations": "ITER_MAX",
    "filters.iterated.threshold": "ITER_THRESHOLD",
    "filters.srcdkf.full": "SRCDKF_FULL",
    "sources.gnss": "SRC_GNSS",
    "sources.vertical_velocity": "SRC_VERT_VEL",
    "sources.heading": "SRC_HEADING",
    "streams.local_position_ned": "SR_LOCAL_POS",
    "streams.attitude": "SR_ATTITUDE",
    "streams.attitude_quaternion": "SR_ATT_QUAT",
    "streams.odometry": "SR_ODOMETRY",
    "streams.global_position_int": "SR_GLOBAL_POS",
    "streams.highres_imu": "SR_HIGHRES_IMU",
    "streams.estimator_status": "SR_EST_STATUS",
    "streams.local_position_ned_cov": "SR_LOCAL_COV",
    "streams.attitude_quaternion_cov": "SR_ATT_COV",
    "streams.global_position_int_cov": "SR_GLOBAL_COV",
    "streams.ekf_status_report": "SR_EKF_STATUS",
    "streams.vibration": "SR_VIBRATION",
    "streams.gps_global_origin": "SR_ORIGIN",
    "streams.home_position": "SR_HOME",
    "streams.sys_status": "SR_SYS_STATUS",
    "streams.extended_sys_state": "SR_EXT_STATE",
    "streams.system_time": "SR_SYSTEM_TIME",
    "mavlink.persona": "MAV_PERSONA",
    "mavlink.sysid": "MAV_SYSID",
    "mavlink.compid": "MAV_COMPID",
    "mavlink.route": "MAV_ROUTE",
    "mavlink.peer_timeout": "MAV_PEER_TIMEOUT",
    "mavlink.vehicle_timeout": "MAV_VEH_TIMEOUT",
    "mavlink.max_peers": "MAV_PEERS_MAX",
    "mavlink.max_vehicles": "MAV_VEHICLES_MAX",
}
"""Dotted path -> the parameter's name, or one for each component of a vector."""

EXCLUDED: Final = {
    "mavlink.allow_remote_config": "who may change parameters is not for those who may to decide",
    "signing": "neither is whose packets are believed",
    "limits": "nor who may send, and how much",
}
"""Dotted paths, or sections, that are no parameters, and why."""

NEEDS_RESTART: Final = {**FIXED, "mavlink": "the session is shared by all vehicles"}
"""Dotted paths, or sections, that a change reaches at the next start only, and why."""


def within(path: str, places: dict[str, str]) -> bool:
    """True for a dotted path that stands among `places` by itself or by one of its sections."""
    return any(path == place or path.startswith(f"{place}.") for place in places)
