"""Terms of the inertial unit."""

from __future__ import annotations

from math import radians

from slam.simulation.terms.term import Term, signed

_AXES = ("x", "y", "z")

IMU = (
    Term(
        name="gyro_bias",
        family="imu",
        acts_on="sensor",
        parameters=tuple(signed(axis, "rad/s", radians(2), 1.0) for axis in _AXES),
        equation="added to the body rate",
        confounders=("gyro_scale",),
        excitation="rest on the floor at start and end",
    ),
    Term(
        name="gyro_scale",
        family="imu",
        acts_on="sensor",
        parameters=(signed("eps", "1", 0.03, 0.5),),
        equation="the body rate times 1 + eps, all axes",
        confounders=("yaw_drag",),
        excitation="yaw steps, with the heading from the camera",
    ),
    Term(
        name="accel_bias",
        family="imu",
        acts_on="sensor",
        parameters=tuple(signed(axis, "m/s^2", 0.3, 5.0) for axis in _AXES),
        equation="added to the specific force",
        confounders=("trim_offset", "accel_scale"),
        excitation="rest on the floor, and a rotation by 180 deg",
    ),
    Term(
        name="accel_scale",
        family="imu",
        acts_on="sensor",
        parameters=(signed("eps", "1", 0.03, 0.5),),
        equation="the specific force times 1 + eps, all axes",
        confounders=("accel_bias",),
        excitation="fast climbs and tilts",
    ),
    Term(
        name="imu_misalignment",
        family="imu",
        acts_on="sensor",
        parameters=tuple(signed(axis, "rad", radians(3), 0.5) for axis in _AXES),
        equation="the unit is rotated against the body by this rotation vector",
        confounders=("accel_bias", "trim_offset"),
        excitation="fast tilts and yaw: one axis shows in another",
    ),
)
