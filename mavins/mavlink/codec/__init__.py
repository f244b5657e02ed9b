"""MAVLink bytes <-> SI: the only place of mavins that knows wire units.

    frames = scan(datagram)            # every intact packet, damage counted
    for i in range(len(frames)):
        message = decode(frames, i)    # a frozen record, Invalid or None

    packet = frame(local_position_ned(solution), sysid=100, compid=1, seq=0)

fields: wire layouts from pymavlink's dialect; framing: packets in bytes; messages, decode, tables: bytes
-> SI; encode, outputs: SI -> bytes.
"""

from mavins.mavlink.codec.decode import (
    FIRST_UNIX_US,
    decode,
    decode_truth,
)
from mavins.mavlink.codec.encode import (
    ACCEL_AND_GYRO,
    Payload,
    attitude,
    boot_ms,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    hil_state_quaternion,
    payload,
    system_time,
)
from mavins.mavlink.codec.fields import WIRE, Fields, fields_of, name_of
from mavins.mavlink.codec.framing import Damage, Frames, scan, scan_tlog
from mavins.mavlink.codec.messages import (
    IMU_KINDS,
    WRAPPING_IMU_KINDS,
    Attitude,
    GlobalPosition,
    GpsInput,
    GpsRaw,
    Heartbeat,
    HilGps,
    HilState,
    ImuMessage,
    ImuRows,
    Invalid,
    Message,
    OriginRequest,
    SimState,
    SystemTime,
    Truth,
)
from mavins.mavlink.codec.outputs import (
    attitude_from,
    attitude_quaternion,
    autopilot_version,
    command_ack,
    estimator_status,
    global_position_from,
    gps_global_origin,
    highres_imu_from,
    home_position,
    local_position_ned,
    odometry,
    param_value,
    pose_and_twist,
    statustext,
    sys_status,
)
from mavins.mavlink.codec.tables import decode_fields, decode_imu, payload_rows

__all__ = [
    "ACCEL_AND_GYRO",
    "FIRST_UNIX_US",
    "IMU_KINDS",
    "WIRE",
    "WRAPPING_IMU_KINDS",
    "Attitude",
    "Damage",
    "Fields",
    "Frames",
    "GlobalPosition",
    "GpsInput",
    "GpsRaw",
    "Heartbeat",
    "HilGps",
    "HilState",
    "ImuMessage",
    "ImuRows",
    "Invalid",
    "Message",
    "OriginRequest",
    "Payload",
    "SimState",
    "SystemTime",
    "Truth",
    "attitude",
    "attitude_from",
    "attitude_quaternion",
    "autopilot_version",
    "boot_ms",
    "command_ack",
    "decode",
    "decode_fields",
    "decode_imu",
    "decode_truth",
    "estimator_status",
    "fields_of",
    "frame",
    "global_position_from",
    "global_position_int",
    "gps_global_origin",
    "gps_raw_int",
    "heartbeat",
    "highres_imu",
    "highres_imu_from",
    "hil_state_quaternion",
    "home_position",
    "local_position_ned",
    "name_of",
    "odometry",
    "param_value",
    "payload",
    "payload_rows",
    "pose_and_twist",
    "scan",
    "scan_tlog",
    "statustext",
    "sys_status",
    "system_time",
]
