"""PX4's own messages in ROS 2 recordings (``px4_msgs``): the rules of its logs, and its odometry.

Fields, axes and units are those of a PX4 log, forward-right-down and north-east-down, without a header.
Source: the message definitions in PX4-Autopilot/msg, from which both are generated.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.rotations import roll_pitch_yaw_of, rotation_of
from slam.io.body_axes import FRD_R_B, W_R_N, angles_from_ned_quaternion
from slam.io.recordings.logs.field_rules import FieldRule
from slam.io.recordings.logs.field_values import Converted, Fields
from slam.io.recordings.logs.ulog import RULES as RULES_OF_LOGS
from slam.io.recordings.ros.messages import NO_TRUTH, RosRule, heading_axes, is_reference
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
RosMessage = Any

PACKAGE = "px4_msgs/msg/"
_GPS = "latitude_deg longitude_deg altitude_msl_m lat lon alt fix_type eph epv"
_FLOW = "pixel_flow[2] delta_angle[2] integration_timespan_us distance_m quality"
_FIELDS = {
    "sensor_combined": "gyro_rad[3] accelerometer_m_s2[3]",
    "distance_sensor": "current_distance min_distance max_distance orientation variance signal_quality",
    "vehicle_attitude": "q[4] quat_reset_counter",
    "vehicle_optical_flow": _FLOW,
    "sensor_optical_flow": _FLOW,
    "optical_flow": "pixel_flow_x_integral pixel_flow_y_integral gyro_x_rate_integral gyro_y_rate_integral "
    "integration_timespan ground_distance_m quality",
    "manual_control_setpoint": "pitch roll throttle yaw x y z r",
    "battery_status": "voltage_v",
    "vehicle_gps_position": _GPS,
    "sensor_gps": _GPS,
    "vehicle_air_data": "baro_alt_meter",
    "actuator_motors": "control[4]",
}
"""Topic of a log -> the fields that its rules read; several versions of a message have different ones."""
_NED, _FRD, _BODY = 1, 2, 3
"""Frames of odometry: north-east-down, forward-right-down of any heading, and the body's axes."""


def _names(kind: str) -> tuple[str, ...]:
    """Return the fields of a message; those of an array are numbered."""
    found = []
    for word in _FIELDS[kind].split():
        name, _, length = word.rstrip("]").partition("[")
        found += [f"{name}[{k}]" for k in range(int(length))] if length else [name]
    return tuple(found)


def _row(message: RosMessage, names: tuple[str, ...]) -> tuple[float, ...]:
    """Return the values of fields; NaN for those that this version of the message does not have."""
    return tuple(_number(message, *name.rstrip("]").partition("[")[::2]) for name in names)


def _number(message: RosMessage, name: str, at: str) -> float:
    value: Any = getattr(message, name, None)
    if value is None:
        return np.nan
    return float(value[int(at)] if at else value)


def _converted(rows: Array, rule: FieldRule) -> Converted:
    return rule.values(_fields(rows, rule))


def _fields(rows: Array, rule: FieldRule) -> Fields:
    """Return name -> values; a field that this version of the message does not have is left out."""
    names = _names(rule.kind)
    here = {name: rows[:, k] for k, name in enumerate(names)}
    return {name: v for name, v in here.items() if name in rule.needs or not np.isnan(v).all()}


def _of_log(rule: FieldRule) -> RosRule:
    """Return the rule for the ROS message that holds what a topic of the log does."""
    names = _names(rule.kind)

    def values(rows: Array, b_T_s: Array | None) -> Array:
        return _converted(rows, rule)[0]

    def nominal(rows: Array) -> dict[str, Value]:
        return rule.nominal(_fields(rows, rule))

    return RosRule(
        stream=rule.stream,
        kind=PACKAGE + "".join(word.capitalize() for word in rule.kind.split("_")),
        row=partial(_row, names=names),
        values=values,
        reading=rule.reading,
        nominal=nominal,
        remarks=lambda rows: _converted(rows, rule)[1],
        needs=tuple(re.sub(r"\[\d+\]", "", name) for name in rule.needs),
        is_certain=lambda topic: "groundtruth" not in topic,
        doubt="a simulator's truth, not a reading",
    )


def _pose(m: RosMessage) -> tuple[float, ...]:
    """Return frame, position and quaternion; older messages have x, y, z, and count frames from zero."""
    position = m.position if hasattr(m, "position") else (m.x, m.y, m.z)
    frame = m.pose_frame if hasattr(m, "pose_frame") else m.local_frame + 1
    return frame, *position, *m.q


def _attitude(rows: Array, b_T_s: Array | None) -> Array:
    return np.where(np.isin(rows[:, :1], (_NED, _FRD)), angles_from_ned_quaternion(rows[:, 4:8]), np.nan)


def _truth(rows: Array, b_T_s: Array | None) -> Array:
    """Return poses in the columns of the truth; velocity and biases are not there."""
    angles = _attitude(rows, b_T_s)
    known = np.isfinite(angles).all(axis=1, keepdims=True)
    w_q = Rotation.from_matrix(rotation_of(np.nan_to_num(angles))).as_quat(scalar_first=True)
    pose = np.where(known, np.hstack([rows[:, 1:4] @ W_R_N.T, w_q]), np.nan)
    return np.hstack([pose, np.full((len(rows), 9), np.nan)])


def _motion(m: RosMessage) -> tuple[float, ...]:
    return *_pose(m), m.velocity_frame, *m.velocity


def _level_velocity(rows: Array, b_T_s: Array | None) -> Array:
    """Return velocities (n, 2) forward and left, level."""
    angles = _attitude(rows, b_T_s)
    w_R_b = rotation_of(np.nan_to_num(angles))
    in_body = rows[:, 8] == _BODY
    frame_v = rows[:, 9:12]
    of_body = np.einsum("nij,nj->ni", w_R_b, frame_v @ FRD_R_B.T)
    w_v = np.where(in_body[:, None], of_body, frame_v @ W_R_N.T)
    level = heading_axes(w_v, roll_pitch_yaw_of(w_R_b)[:, 2])
    known = np.isfinite(angles).all(axis=1) & (in_body | (rows[:, 8] == rows[:, 0]))
    return np.where(known[:, None], level, np.nan)


_ODOMETRY = f"{PACKAGE}VehicleOdometry"
_AXES = "north-east-down and forward-right-down to east-north-up and forward-left-up"
PX4_RULES: tuple[RosRule, ...] = (
    *(_of_log(rule) for rule in RULES_OF_LOGS if all(name in _names(rule.kind) for name in rule.needs)),
    RosRule(
        "attitude0",
        _ODOMETRY,
        _pose,
        _attitude,
        f"quaternion; {_AXES}",
        needs=("q",),
        is_certain=lambda topic: "mocap" not in topic and "visual" not in topic,
        doubt="an attitude by other cameras",
    ),
    RosRule(
        "velocity0",
        _ODOMETRY,
        _motion,
        _level_velocity,
        f"m/s, levelled; {_AXES}",
        needs=("velocity_frame", "velocity", "q"),
        is_certain=lambda topic: False,
        doubt="the autopilot's filter already contains GPS and flow",
    ),
    RosRule(
        "state_groundtruth_estimate0",
        _ODOMETRY,
        _pose,
        _truth,
        f"m, quaternion; {_AXES}",
        needs=("q",),
        is_certain=is_reference,
        doubt=NO_TRUTH,
    ),
)
"""The message types of PX4 and what they become, in the order of preference."""
