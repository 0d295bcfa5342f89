"""Corrections of the velocity of the on-board optical flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.flight import Flight, Velocity
from slam.core.rotations import up_at
from slam.simulation.model import Model


def flow_scale(flight: Flight, model: Model) -> Flight:
    """Undo the scale of the velocity."""
    velocity, scale = _velocity(flight), 1 + model.value("flow_scale", "eps")
    std = tuple(s / scale for s in velocity.noise_std_m_s)
    return replace(
        flight,
        velocity=replace(
            velocity,
            v_m_s=velocity.v_m_s / scale,
            noise_std_m_s=(std[0], std[1]),
            scale_std=model.known_to("flow_scale", velocity.scale_std),
        ),
    )


def flow_derotation(flight: Flight, model: Model) -> Flight:
    """Undo the rotation in the flow. Without gyro or sonar the flight stays unchanged."""
    velocity, imu, sonar = _velocity(flight), flight.imu, flight.sonar
    if imu is None or sonar is None or not np.isfinite(sonar.range_m).any():
        return flight
    at_s, valid = velocity.stamps_s, np.isfinite(sonar.range_m)
    turning = imu.gyro_rad_s @ imu.b_T_s[:3, :3].T
    p, q = (np.interp(at_s, imu.stamps_s, turning[:, axis]) for axis in (0, 1))
    range_m = np.interp(at_s, sonar.stamps_s[valid], sonar.range_m[valid])
    height_m = range_m * up_at(flight.attitude, at_s)[:, 2]
    leak_m_s = model.value("flow_derotation", "kappa") * np.column_stack([q, -p]) * height_m[:, None]
    return replace(flight, velocity=replace(velocity, v_m_s=velocity.v_m_s - leak_m_s))


def _velocity(flight: Flight) -> Velocity:
    assert flight.velocity is not None
    return flight.velocity
