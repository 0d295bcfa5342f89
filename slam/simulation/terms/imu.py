"""Terms of the inertial unit."""

from __future__ import annotations

from math import radians

from slam.simulation.terms.term import Term, signed

_AXES = ("x", "y", "z")

IMU = (
    Term(
        "gyro_bias",
        "imu",
        "sensor",
        tuple(signed(axis, "rad/s", radians(2), 1.0) for axis in _AXES),
        "added to the body rate",
        ("gyro_scale",),
        "rest on the floor at start and end",
    ),
    Term(
        "gyro_scale",
        "imu",
        "sensor",
        (signed("eps", "1", 0.03, 0.5),),
        "the body rate times 1 + eps, all axes",
        ("yaw_drag",),
        "yaw steps, with the heading from the camera",
    ),
    Term(
        "accel_bias",
        "imu",
        "sensor",
        tuple(signed(axis, "m/s^2", 0.3, 5.0) for axis in _AXES),
        "added to the specific force",
        ("trim_offset", "accel_scale"),
        "rest on the floor, and a turn by 180 deg",
    ),
    Term(
        "accel_scale",
        "imu",
        "sensor",
        (signed("eps", "1", 0.03, 0.5),),
        "the specific force times 1 + eps, all axes",
        ("accel_bias",),
        "brisk climbs and tilts",
    ),
    Term(
        "imu_misalignment",
        "imu",
        "sensor",
        tuple(signed(axis, "rad", radians(3), 0.5) for axis in _AXES),
        "the unit is turned against the body by this rotation vector",
        ("accel_bias", "trim_offset"),
        "brisk tilts and yaw: one axis shows in another",
    ),
)
