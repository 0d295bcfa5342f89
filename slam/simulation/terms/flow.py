"""Terms of the velocity of the on-board optical flow, in the order in which they act on a reading.

Symbols: v the velocity ahead and to the left, p and q the body rates about these axes, h the height.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slam.core.flight import Flight
from slam.core.rotations import up_at
from slam.core.streams import Velocity
from slam.simulation.state import PITCH, ROLL, YAW, Z
from slam.simulation.terms.term import Array, Term, signed


def _with_rotation(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    if values[first] == 0.0:
        return
    p = rate[ROLL] - np.sin(state[PITCH]) * rate[YAW]
    q = np.cos(state[ROLL]) * rate[PITCH] + np.sin(state[ROLL]) * np.cos(state[PITCH]) * rate[YAW]
    out[0] += values[first] * state[Z] * q
    out[1] -= values[first] * state[Z] * p


def _scaled(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    for i in range(2):
        out[i] *= 1.0 + values[first]


def _without_rotation(flight: Flight, values: Array, std: float | None) -> Flight:
    """Undo the rotation in the flow. Without gyro or sonar the flight stays unchanged."""
    velocity, imu, sonar = _velocity(flight), flight.imu, flight.sonar
    if imu is None or sonar is None or not np.isfinite(sonar.range_m).any():
        return flight
    at_s, valid = velocity.stamps_s, np.isfinite(sonar.range_m)
    turning = imu.gyro_rad_s @ imu.b_T_s[:3, :3].T
    p, q = (np.interp(at_s, imu.stamps_s, turning[:, axis]) for axis in (0, 1))
    range_m = np.interp(at_s, sonar.stamps_s[valid], sonar.range_m[valid])
    height_m = range_m * up_at(flight.attitude, at_s)[:, 2]
    leak_m_s = values[0] * np.column_stack([q, -p]) * height_m[:, None]
    return replace(flight, velocity=replace(velocity, v_m_s=velocity.v_m_s - leak_m_s))


def _without_scale(flight: Flight, values: Array, std: float | None) -> Flight:
    velocity, scale = _velocity(flight), 1.0 + float(values[0])
    ahead, left = (s / scale for s in velocity.noise_std_m_s)
    divided = replace(
        velocity,
        v_m_s=velocity.v_m_s / scale,
        noise_std_m_s=(ahead, left),
        scale_std=velocity.scale_std if std is None else std,
    )
    return replace(flight, velocity=divided)


def _velocity(flight: Flight) -> Velocity:
    assert flight.velocity is not None
    return flight.velocity


FLOW = (
    Term(
        name="flow_derotation",
        title="rotation in the measured speed",
        meaning="the measured speed contains a share of the rotation",
        family="camera",
        acts_on="sensor",
        instrument="speed sensor",
        parameters=(
            signed("kappa", "1", 0.1, 1.0, step=0.01, quantity="share of the rotation that is left"),
        ),
        equation="the flow speed contains a share of the rotation: v_x += kappa q h, v_y -= kappa p h",
        confounders=("camera_time_offset",),
        excitation="fast tilts at two heights",
        tolerance=0.005,
        in_differences=True,
        stream="velocity",
        read=_with_rotation,
        undo=_without_rotation,
    ),
    Term(
        name="flow_scale",
        title="a speed wrong by a factor",
        meaning="the measured speed over the floor is wrong by a factor",
        family="motion",
        acts_on="sensor",
        instrument="speed sensor",
        parameters=(signed("eps", "1", 0.25, 0.9, step=0.01, quantity="error of the speed"),),
        equation="the on-board flow speed reads (1 + eps) v",
        confounders=("focal_length", "quadratic_drag"),
        excitation="a position reference, or the camera's own metric motion",
        tolerance=0.005,
        in_differences=True,
        stream="velocity",
        read=_scaled,
        undo=_without_scale,
        scales=True,
    ),
)
