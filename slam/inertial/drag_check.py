"""Mean of the measured velocity against the drag that the accelerometer shows.

A constant error of the velocity changes neither its changes nor, at one heading, any other reading. The drag
alone depends on the speed itself: the thrust of a multirotor is along its body's z, so that the accelerometer
measures the drag along x and y (P. Martin, E. Salaün, ICRA 2010). It vanishes at the velocity of the air. A
wind, or an error of the velocity, is left, and no flight at one heading tells these apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.significance import SURE_SIGMAS
from slam.core.messages import Message, warning
from slam.inertial.instruments import InertialTrust
from slam.inertial.window_means import window_means

if TYPE_CHECKING:
    from slam.core.flight import Flight

Array = NDArray[np.float64]

_WINDOW_S = 1.0
"""Readings are averaged over ten times the time in which the attitude follows its target."""
_LEAST_WINDOWS = 4
"""Fewer leave the variance of their means unknown by more than a factor of two."""
_DRAG_1_S, _DRAG_FACTOR = 0.4, 2.0
"""Median of the drag coefficient and its standard deviation as a factor. Measured flights gave 0.3 to 0.6."""
_DRAGS_1_S = _DRAG_1_S * np.geomspace(_DRAG_FACTOR**-2, _DRAG_FACTOR**2, 41)
"""Coefficients that are tried, to two standard deviations."""
_LIGHT_BREEZE_M_S, _FRESH_BREEZE_M_S = 1.6, 8.0
"""Least winds of 2 and 5 on Beaufort's scale. One feels the first on the face; small drones do not fly in the
second."""


@dataclass(frozen=True)
class AirVelocity:
    """Velocity forward and left at which the drag vanishes: that of the air, or an error of the velocity."""

    v_m_s: Array
    """(2,), the most probable one."""
    least_m_s: float
    """Speed that it surely has; negative where it may be none."""


@dataclass(frozen=True)
class DragContradiction:
    """A velocity that differs from the one by which the accelerometer shows drag."""

    line: Message
    is_wind_excluded: bool
    """Whether the velocity is wrong, because no wind explains the difference."""


def air_velocity(flight: Flight, trust: InertialTrust = InertialTrust()) -> AirVelocity | None:
    """Return the velocity at which the accelerometer's drag vanishes; None where too little was recorded."""
    windows = _window_means(flight)
    if windows is None:
        return None
    force, velocity = windows
    without_drag = force + _DRAGS_1_S[:, None, None] * velocity
    # No spread at all would be infinitely probable.
    mean, spread = without_drag.mean(axis=1), np.maximum(without_drag.var(axis=1, ddof=1), 1e-12)
    prior = -0.5 * (np.log(_DRAGS_1_S / _DRAG_1_S) / np.log(_DRAG_FACTOR)) ** 2
    log_probability = prior - 0.5 * len(force) * np.log(spread).sum(axis=1)
    possible = log_probability > log_probability.max() - 0.5 * SURE_SIGMAS**2
    v_m_s = mean / _DRAGS_1_S[:, None]
    std_m_s = np.sqrt(trust.accel_offset_m_s2**2 + spread.max(axis=1) / len(force)) / _DRAGS_1_S
    least = np.hypot(*v_m_s.T) - SURE_SIGMAS * std_m_s
    return AirVelocity(v_m_s[np.argmax(log_probability)], float(least[possible].min()))


def drag_contradiction(flight: Flight, trust: InertialTrust = InertialTrust()) -> DragContradiction | None:
    """Describe how the drag contradicts the velocity; None where it does not.

    Positions show a wind, so that there is no such line in a flight with GPS.
    """
    air = air_velocity(flight, trust) if flight.gps is None else None
    if air is None or air.least_m_s < _LIGHT_BREEZE_M_S:
        return None
    found = (
        f"by the drag in imu0, velocity0 has a constant error or the wind blew with {air.v_m_s[0]:.2g} m/s "
        f"forward and {air.v_m_s[1]:.2g} m/s left ({air.least_m_s:.2g} m/s at least)"
    )
    if air.least_m_s < _FRESH_BREEZE_M_S:
        told_by = "a flight that turns tells which: wind keeps its direction over ground"
        return DragContradiction(warning(found, told_by), False)
    doubted = warning(
        f"{found}: small drones do not fly in so much wind, and the track over ground is not to be trusted",
        "check the zero of velocity0 on the ground, and fly turns, in which the other instruments show its "
        "error",
    )
    return DragContradiction(doubted, True)


def _window_means(flight: Flight) -> tuple[Array, Array] | None:
    """Return specific force and velocity (n, 2), forward and left, as means over the same windows."""
    imu, velocity = flight.imu, flight.velocity
    if imu is None or velocity is None:
        return None
    read = np.isfinite(velocity.v_m_s).all(axis=1)
    felt = np.isfinite(imu.accel_m_s2).all(axis=1)
    if not read.any() or not felt.any():
        return None
    b_force = imu.accel_m_s2[felt] @ imu.b_T_s[:3, :3].T
    force_s, read_s = imu.stamps_s[felt], velocity.stamps_s[read]
    begin_s, end_s = max(force_s[0], read_s[0]), min(force_s[-1], read_s[-1])
    of_force, force = window_means(force_s, b_force[:, :2], begin_s, _WINDOW_S)
    of_read, level = window_means(read_s, velocity.v_m_s[read], begin_s, _WINDOW_S)
    both, at_force, at_read = np.intersect1d(of_force, of_read, assume_unique=True, return_indices=True)
    whole = (both >= 0) & (begin_s + (both + 1) * _WINDOW_S <= end_s)
    return (force[at_force[whole]], level[at_read[whole]]) if whole.sum() >= _LEAST_WINDOWS else None
