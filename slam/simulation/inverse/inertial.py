"""Corrections of gyro and accelerometer. A model describes readings in body axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.simulation.model import Model

Array = NDArray[np.float64]


def _in_body_axes(flight: Flight, gyro: Callable[[Array], Array], accel: Callable[[Array], Array]) -> Flight:
    imu = flight.imu
    assert imu is not None
    b_R_s = imu.b_T_s[:3, :3]
    corrected = replace(
        imu,
        gyro_rad_s=gyro(imu.gyro_rad_s @ b_R_s.T) @ b_R_s,
        accel_m_s2=accel(imu.accel_m_s2 @ b_R_s.T) @ b_R_s,
    )
    return replace(flight, imu=corrected)


def _unchanged(values: Array) -> Array:
    return values


def gyro_bias(flight: Flight, model: Model) -> Flight:
    """Undo the bias of the gyro."""
    return _in_body_axes(flight, lambda w: w - model.vector("gyro_bias"), _unchanged)


def gyro_scale(flight: Flight, model: Model) -> Flight:
    """Undo the scale of the gyro."""
    return _in_body_axes(flight, lambda w: w / (1 + model.value("gyro_scale", "eps")), _unchanged)


def accel_bias(flight: Flight, model: Model) -> Flight:
    """Undo the bias of the accelerometer."""
    return _in_body_axes(flight, _unchanged, lambda a: a - model.vector("accel_bias"))


def accel_scale(flight: Flight, model: Model) -> Flight:
    """Undo the scale of the accelerometer."""
    return _in_body_axes(flight, _unchanged, lambda a: a / (1 + model.value("accel_scale", "eps")))


def imu_misalignment(flight: Flight, model: Model) -> Flight:
    """Undo the rotation of the IMU against the body."""
    b_R_u = Rotation.from_rotvec(model.vector("imu_misalignment"))
    return _in_body_axes(flight, b_R_u.apply, b_R_u.apply)
