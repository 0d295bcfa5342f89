"""ROS messages of drivers that hold velocities, ranges or heights under other types than the usual ones.

MAVROS turns the flow sensor's angles into forward-left-up axes (mavros_extras, ``px4flow``). Sources: the
message definitions of ``mavros_msgs``, ``px_comm`` and ``common_interfaces``; DJI's Onboard SDK for ROS.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.io.recordings.logs.field_values import flow_velocity, standard_altitude
from slam.io.recordings.range_limits import limits_entries, stated_limits
from slam.io.recordings.ros.messages import LASER_SCAN, RosRule, level_velocity, ranges_within
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
RosMessage = Any

_LEAST_PA, _MOST_PA = 3e4, 1.1e5
"""Pressures between 9 km up and below sea level; that of an airspeed sensor is a difference."""
_FLOW, _PX4FLOW = "mavros_msgs/msg/OpticalFlowRad", "px_comm/msg/OpticalFlow"


def _ray(m: RosMessage) -> tuple[float, ...]:
    """Return a scan of one ray as a range; an empty row for other scans, which do not fit."""
    return (float(m.ranges[0]), m.range_min, m.range_max) if len(m.ranges) == 1 else ()


def _ray_limits(rows: Array) -> dict[str, Value]:
    return limits_entries(stated_limits(rows[:, 1], rows[:, 2]))


def _pressure(m: RosMessage) -> tuple[float, ...]:
    return (m.fluid_pressure,)


def _altitude(rows: Array, b_T_s: Array | None) -> Array:
    known = np.where((rows > _LEAST_PA) & (rows < _MOST_PA), rows, np.nan)
    return standard_altitude(known[:, 0] * 1e-2)


def _flow(m: RosMessage) -> tuple[float, ...]:
    turned = m.integrated_x - m.integrated_xgyro, m.integrated_y - m.integrated_ygyro
    return *turned, m.integration_time_us, m.distance, m.quality


def _flow_speed(rows: Array, b_T_s: Array | None) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = rows[:, :2] * (1.0, -1.0) / (rows[:, 2:3] * 1e-6)  # y to the right, as the autopilot's
    return flow_velocity(rate, rows[:, 3], (rows[:, 3] > 0) & (rows[:, 4] > 0))[0]


def _flow_range(m: RosMessage) -> tuple[float, ...]:
    return (m.distance,)


def _ground_distance(m: RosMessage) -> tuple[float, ...]:
    return (m.ground_distance,)


def _positive(rows: Array, b_T_s: Array | None) -> Array:
    return np.where(rows > 0, rows, np.nan)


def _sensor_velocity(m: RosMessage) -> tuple[float, ...]:
    return m.velocity_x, m.velocity_y


def _vector(m: RosMessage) -> tuple[float, ...]:
    return m.vector.x, m.vector.y, m.vector.z


def _is_velocity(topic: str) -> bool:
    name = topic.rpartition("/")[2]
    return "velocity" in name and "angular" not in name


DRIVER_RULES: tuple[RosRule, ...] = (
    RosRule("sonar0", LASER_SCAN, _ray, ranges_within, "m along x, one ray", _ray_limits, is_mounted=True),
    RosRule("sonar0", _FLOW, _flow_range, _positive, "m, taken as facing down"),
    RosRule("sonar0", _PX4FLOW, _ground_distance, _positive, "m, taken as facing down"),
    RosRule("velocity0", _FLOW, _flow, _flow_speed, "rad, m; to m/s forward and left, taken as level"),
    RosRule(
        "velocity0",
        _PX4FLOW,
        _sensor_velocity,
        level_velocity,
        "m/s, x and y of the sensor taken as forward and left",
        is_certain=lambda topic: False,
        doubt="velocities in the sensor's axes, whose mount is unknown",
    ),
    RosRule(
        "velocity0",
        "geometry_msgs/msg/Vector3Stamped",
        _vector,
        level_velocity,
        "m/s forward and left, taken as level",
        is_certain=_is_velocity,
        doubt="by its name no velocity",
    ),
    RosRule("barometer0", "sensor_msgs/msg/FluidPressure", _pressure, _altitude, "Pa to m by ISO 2533"),
)
"""The message types of drivers and what they become, in the order of preference."""
