"""Reported velocities and turns, integrated between two nodes of the path.

Vectors of the level plane are complex numbers: forward is the real part, left the imaginary one, and a turn
is the product with a unit number. So each integral is one cumulative sum over the flight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.measurements import ReportedMotion
from backend.preintegration.integrals import covered, integrate

Array = NDArray[np.float64]

_LEAST_GAP_S = 0.3
"""Time without a reading that is no gap: a small vehicle changes its speed little in it."""
_NEAR_S = 0.1
"""Half the time over which velocities are averaged, so that their noise does not look like a lag."""


@dataclass(frozen=True)
class ReportedInterval:
    """Motion between two successive nodes, in level axes along the mean heading of both."""

    i: int
    j: int
    lasts_s: float
    turn_rad: float
    moved: complex
    """Integral of the velocity, m."""
    by_turn: complex
    """Its change for each radian that the turn is larger than reported, if that error grows evenly."""
    by_lag: complex
    """Its change for each second that the velocities are late."""
    by_bias: complex
    """Its change for each m/s of a constant error of the velocity; the turn reduces it."""


def integrate_reported(motion: ReportedMotion, stamps_s: Array) -> tuple[ReportedInterval, ...]:
    """Integrate the motion between successive nodes at increasing ``stamps_s`` (n,).

    Intervals that are not covered by readings of both kinds are left out.
    """
    known = [covered(read_s, stamps_s, _LEAST_GAP_S) for read_s in (motion.stamps_s, motion.yaw_stamps_s)]
    times_s = np.unique(np.concatenate([motion.stamps_s, motion.yaw_stamps_s, stamps_s]))
    forward, left = (np.interp(times_s, motion.stamps_s, axis) for axis in motion.v_m_s.T)
    heading = np.exp(1j * np.interp(times_s, motion.yaw_stamps_s, motion.yaw_rad))
    read = forward + 1j * left
    velocity = read * heading
    place, moment, turned = (integrate(times_s, y) for y in (velocity, velocity * times_s, heading))
    at = np.searchsorted(times_s, stamps_s)
    late = _effect_of_lag(times_s, read, heading)
    yaw = np.interp(stamps_s, motion.yaw_stamps_s, motion.yaw_rad)
    intervals = []
    for k in np.flatnonzero(known[0] & known[1]).tolist():
        i, j, lasts_s = at[k], at[k + 1], float(stamps_s[k + 1] - stamps_s[k])
        back = np.exp(-0.5j * (yaw[k] + yaw[k + 1]))
        moved = place[j] - place[i]
        early = moment[j] - moment[i] - (stamps_s[k] + stamps_s[k + 1]) / 2 * moved
        intervals.append(
            ReportedInterval(
                i=k,
                j=k + 1,
                lasts_s=lasts_s,
                turn_rad=float(yaw[k + 1] - yaw[k]),
                moved=complex(moved * back),
                by_turn=complex(1j * early / lasts_s * back),
                by_lag=complex((late[j] - late[i]) * back),
                by_bias=complex((turned[j] - turned[i]) * back),
            )
        )
    return tuple(intervals)


def _effect_of_lag(
    times_s: Array, read: NDArray[np.complex128], heading: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Return the integral (n,) of the changes of the velocity, along the heading of the moment."""
    place, beside = integrate(times_s, read), []
    for side in (-_NEAR_S, _NEAR_S):
        at_s = np.clip(times_s + side, times_s[0], times_s[-1])
        beside.append(
            (at_s, np.interp(at_s, times_s, place.real) + 1j * np.interp(at_s, times_s, place.imag))
        )
    (begin_s, begin), (end_s, end) = beside
    mean = (end - begin) / (end_s - begin_s)
    return np.concatenate([[0.0], np.cumsum((heading[1:] + heading[:-1]) / 2 * np.diff(mean))])
