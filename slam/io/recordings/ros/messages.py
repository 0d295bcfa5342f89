"""ROS messages and the streams of a flight that they become.

ROS uses SI units, a world with z up and body axes forward-left-up (REP 103), as a flight does. A sensor's own
axes are related to the body by ``/tf_static``. Source: the message definitions of ``common_interfaces``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.height_systems import ELLIPSOID
from slam.core.messages import Message
from slam.core.rotations import roll_pitch_yaw_of, rotation_of
from slam.io.body_axes import angles_from_quaternion
from slam.io.gps_accuracy import with_accuracy
from slam.io.recordings.range_limits import limits_entries, stated_limits, within
from slam.io.recordings.ros.transforms import is_world
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
RosMessage = Any
"""A deserialised message: its fields are attributes."""

RANGE_T_SONAR: Array = np.array([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Transform from a flight's sonar, which looks along -z, to a ``Range`` sensor, which looks along x."""
_REFERENCE_WORDS = ("truth", "vicon", "mocap", "optitrack", "vrpn", "qualisys", "groundtruth")
"""Words in the topic of a reference. Other poses may be estimates."""


@dataclass(frozen=True)
class RosRule:
    """One message type that can fill one stream."""

    stream: str
    kind: str
    row: Callable[[RosMessage], tuple[float, ...]]
    """Return the numbers of one message."""
    values: Callable[[Array, Array | None], Array]
    """Return values (n, c) of the flight format from all rows and ``b_T_s``, the sensor's mount if known."""
    reading: str
    nominal: Callable[[Array], dict[str, Value]] = lambda rows: {}
    """Return keys of ``sensor.yaml`` from all rows."""
    is_mounted: bool = False
    """Whether ``sensor.yaml`` has the mount."""
    is_certain: Callable[[str], bool] = lambda topic: True
    """Whether a topic may be taken without a request, by its name."""
    doubt: str = ""
    """Reason not to take a topic that is not certain."""
    needs: tuple[str, ...] = ()
    """Fields that distinguish the versions of a message."""
    remarks: Callable[[Array], tuple[Message, ...]] = lambda rows: ()
    """Return a line for everything that is dropped or assumed, from all rows."""
    vectors: tuple[slice, ...] = ()
    """Columns of each vector without which a row has no values."""
    never_zero: slice | None = None
    """Columns of a vector that a driver leaves 0 where it does not measure it."""
    frame: Callable[[RosMessage], str] = lambda message: str(message.header.frame_id)
    """Return the frame whose axes the values have, of a message with a header."""

    def why_missing(self, rows: Array) -> str:
        """Return why the rows (n, c) have no values: a vector is missing throughout; empty if they have some.

        A vector is missing if it is exactly 0 while other values vary. In a simulator, it is 0 at rest.
        """
        if any(not np.isfinite(rows[:, columns]).any() for columns in self.vectors):
            return "its driver states throughout that it does not measure a vector"
        if self.never_zero is None or rows[:, self.never_zero].any():
            return ""
        others = np.delete(rows, self.never_zero, axis=1)
        if (others == others[:1]).all():
            return ""
        return "its driver leaves a vector 0 throughout, which it does not measure"

    def fits(self, message: RosMessage) -> bool:
        """Return whether a message has the fields of the rule: a type may have several versions."""
        try:
            return all(hasattr(message, name) for name in self.needs) and bool(self.row(message))
        except (AttributeError, IndexError, TypeError):
            return False


def _same(rows: Array, b_T_s: Array | None) -> Array:
    return rows


def _vector(v: RosMessage) -> tuple[float, float, float]:
    return v.x, v.y, v.z


def _quaternion(q: RosMessage) -> tuple[float, float, float, float]:
    return q.w, q.x, q.y, q.z


_MISSING_3 = (np.nan,) * 3
_MISSING_4 = (np.nan,) * 4


def _imu(m: RosMessage) -> tuple[float, ...]:
    gyro = _MISSING_3 if m.angular_velocity_covariance[0] == -1 else _vector(m.angular_velocity)
    accel = _MISSING_3 if m.linear_acceleration_covariance[0] == -1 else _vector(m.linear_acceleration)
    return *gyro, *accel


def _imu_attitude(m: RosMessage) -> tuple[float, ...]:
    return _MISSING_4 if m.orientation_covariance[0] == -1 else _quaternion(m.orientation)


def _angles(rows: Array, b_T_s: Array | None) -> Array:
    """Return the body's angles from quaternions of the sensor."""
    angles = angles_from_quaternion(rows)
    if b_T_s is None or np.allclose(b_T_s[:3, :3], np.eye(3)):
        return angles
    known = np.isfinite(angles).all(axis=1, keepdims=True)
    w_R_b = rotation_of(np.where(known, angles, 0.0)) @ b_T_s[:3, :3].T
    return np.where(known, roll_pitch_yaw_of(w_R_b), np.nan)


def _range(m: RosMessage) -> tuple[float, ...]:
    return m.range, m.min_range, m.max_range, m.field_of_view


def _range_limits(rows: Array) -> dict[str, Value]:
    beam_rad = float(np.median(rows[:, 3]))
    limits = limits_entries(stated_limits(rows[:, 1], rows[:, 2]))
    return limits | ({"beam_width": repr(beam_rad)} if 0 < beam_rad < np.pi else {})


def ranges_within(rows: Array, b_T_s: Array | None) -> Array:
    """Return ranges (n, 1) of rows with range and limits, NaN where they are beyond these, or infinite."""
    is_known = within(rows[:, 0], stated_limits(rows[:, 1], rows[:, 2]))
    return np.where(is_known[:, None], rows[:, :1], np.nan)


def _position(m: RosMessage) -> tuple[float, ...]:
    variance = (
        np.diag(np.reshape(m.position_covariance, (3, 3))) if m.position_covariance_type else _MISSING_3
    )
    place = _MISSING_3 if m.status.status < 0 else (m.latitude, m.longitude, m.altitude)
    return *place, *(float(v) for v in variance)


def _places(rows: Array, b_T_s: Array | None) -> Array:
    return with_accuracy(rows[:, :3], np.sqrt(np.maximum(rows[:, 3:], 0.0)))


def _twist(m: RosMessage) -> tuple[float, ...]:
    return _vector(m.twist.twist.linear if hasattr(m.twist, "twist") else m.twist.linear)


def level_velocity(rows: Array, b_T_s: Array | None) -> Array:
    """Return the first two components (n, 2) of velocities, taken as level."""
    return rows[:, :2]


def _odometry(m: RosMessage) -> tuple[float, ...]:
    turned = float(is_world(m.child_frame_id))
    pose = m.pose.pose
    # A twist of 0 is none where the position changes.
    return *_quaternion(pose.orientation), *_vector(m.twist.twist.linear), turned, *_vector(pose.position)


def _frame_of_twist(m: RosMessage) -> str:
    return str(m.child_frame_id)


def heading_axes(w_v: Array, yaw_rad: Array) -> Array:
    """Return velocities forward and left (n, 2) from those in the world (n, 2 or 3) and the yaw (n,)."""
    east, north = w_v[:, 0], w_v[:, 1]
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([cos * east + sin * north, cos * north - sin * east])


def _heading_velocity(rows: Array, b_T_s: Array | None) -> Array:
    """Return level velocities, without yaw, from attitude quaternions and velocities.

    The velocities are in body axes, or in those of the world where column 7 is not 0.
    """
    angles = angles_from_quaternion(rows[:, :4])
    of_world = heading_axes(rows[:, 4:7], angles[:, 2])
    level_R_b = rotation_of(np.nan_to_num(angles * (1.0, 1.0, 0.0)))
    of_body = np.einsum("nij,nj->ni", level_R_b, rows[:, 4:7])[:, :2]
    known = np.isfinite(angles).all(axis=1, keepdims=True)
    return np.where(known, np.where(rows[:, 7:8] != 0, of_world, of_body), np.nan)


def _pose(m: RosMessage) -> tuple[float, ...]:
    pose = getattr(m.pose, "pose", m.pose)
    return *_vector(pose.position), *_quaternion(pose.orientation)


def _transform(m: RosMessage) -> tuple[float, ...]:
    return *_vector(m.transform.translation), *_quaternion(m.transform.rotation)


def _reference(rows: Array, b_T_s: Array | None) -> Array:
    """Return poses in the columns of the truth; velocity and biases are not there."""
    w_q, position = rows[:, 3:7], rows[:, :3]
    if b_T_s is not None:
        w_R_s = Rotation.from_quat(w_q, scalar_first=True)
        b_T = np.linalg.inv(b_T_s)
        position = position + w_R_s.apply(b_T[:3, 3])
        w_q = (w_R_s * Rotation.from_matrix(b_T[:3, :3])).as_quat(scalar_first=True)
    return np.hstack([position, w_q, np.full((len(rows), 9), np.nan)])


def is_reference(topic: str) -> bool:
    """Return whether a topic is named after a system of reference."""
    return any(word in topic.lower().replace("_", "") for word in _REFERENCE_WORDS)


def _driver_angles(rows: Array, b_T_s: Array | None) -> Array:
    return np.radians(rows)


def _quaternion_of_odometry(m: RosMessage) -> tuple[float, ...]:
    return _quaternion(m.pose.pose.orientation)


def _stamped(m: RosMessage) -> tuple[float, ...]:
    return _quaternion(m.quaternion)


def _stick(m: RosMessage) -> tuple[float, ...]:
    return *_vector(m.linear), m.angular.z


def _from_millimetres(rows: Array, b_T_s: Array | None) -> Array:
    return rows * 1e-3


def _never(topic: str) -> bool:
    return False


NO_TRUTH = "a pose may be an estimate, not a truth"
_TRUTH = "state_groundtruth_estimate0"
_POSE = "m, quaternion; body in the world"
_LEVEL = "m/s forward and left, taken as level"
_LEVELLED = "m/s, levelled by the attitude"
IMU, ODOMETRY = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
RANGE_KINDS = ("sensor_msgs/msg/Range", LASER_SCAN)
"""Types of the sensors that measure along their x."""
_NAVDATA = "ardrone_autonomy/msg/Navdata"
_GEOMETRY = "geometry_msgs/msg/"
STANDARD_RULES: tuple[RosRule, ...] = (
    RosRule(
        "imu0",
        IMU,
        _imu,
        _same,
        "rad/s, m/s²",
        is_mounted=True,
        vectors=(slice(0, 3), slice(3, 6)),
        never_zero=slice(3, 6),
    ),
    RosRule(
        "sonar0", "sensor_msgs/msg/Range", _range, ranges_within, "m along x", _range_limits, is_mounted=True
    ),
    RosRule("sonar0", _NAVDATA, lambda m: (m.altd,), _from_millimetres, "mm to m"),
    RosRule("attitude0", f"{_GEOMETRY}QuaternionStamped", _stamped, _angles, "quaternion"),
    RosRule("attitude0", IMU, _imu_attitude, _angles, "quaternion"),
    RosRule("attitude0", ODOMETRY, _quaternion_of_odometry, _angles, "quaternion", frame=_frame_of_twist),
    RosRule("attitude0", _NAVDATA, lambda m: (m.rotX, m.rotY, m.rotZ), _driver_angles, "deg to rad"),
    RosRule("velocity0", f"{_GEOMETRY}TwistStamped", _twist, level_velocity, _LEVEL),
    RosRule("velocity0", f"{_GEOMETRY}TwistWithCovarianceStamped", _twist, level_velocity, _LEVEL),
    RosRule(
        "velocity0",
        ODOMETRY,
        _odometry,
        _heading_velocity,
        _LEVELLED,
        vectors=(slice(4, 7),),
        never_zero=slice(4, 7),
        frame=_frame_of_twist,
    ),
    RosRule("velocity0", _NAVDATA, lambda m: (m.vx, m.vy), _from_millimetres, "mm/s to m/s"),
    RosRule(
        "command0",
        f"{_GEOMETRY}Twist",
        _stick,
        _same,
        "1; forward, left, up, yaw",
        is_certain=_never,
        doubt="commands in m/s?",
    ),
    RosRule("battery0", "sensor_msgs/msg/BatteryState", lambda m: (m.voltage,), _same, "V"),
    RosRule(
        "gps0",
        "sensor_msgs/msg/NavSatFix",
        _position,
        _places,
        "deg, m above the ellipsoid",
        nominal=lambda rows: {"height_system": ELLIPSOID},
    ),
    *(
        RosRule(_TRUTH, kind, row, _reference, _POSE, is_certain=is_reference, doubt=NO_TRUTH)
        for kind, row in (
            (f"{_GEOMETRY}PoseStamped", _pose),
            (f"{_GEOMETRY}PoseWithCovarianceStamped", _pose),
            (f"{_GEOMETRY}TransformStamped", _transform),
            (ODOMETRY, _pose),
        )
    ),
)
"""The message types of ROS itself and what they become, in the order of preference."""

IMAGE_KINDS = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORM_KINDS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
