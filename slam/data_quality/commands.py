"""Command logs: whether there is one, whether it is of the readings' time, and whether it was lost.

A stick at rest under a vehicle that tilts or climbs means that the log was lost.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.data_quality.dead_streams import FEWEST_READINGS
from slam.simulation.dynamics import TURN
from slam.simulation.stick import Stick

Array = NDArray[np.float64]

LEAST_STICK = 0.01
"""Deflections below this count as a stick at rest."""
CONTROLLER_SHARE = 0.5
"""Least share of log entries at which a stick that a controller moves has changed."""
AROUND_S = 1.0
"""Time before and after the readings in which commands count as given while there are readings."""
CALM_RAD, CALM_M_S, CALM_M = 0.1, 1.0, 0.3
"""Ranges that a hover stays within: tilt, the speed that such a tilt makes within a second, and height."""
UNANSWERED_RAD = 0.01
"""Range of the tilt in rad over that of the sticks ahead and to the left, below which a vehicle stands. A
full stick tilts one in the air by more than 10 deg. The log of a PX4 on the ground has 0.002."""
ECHOES = 0.1
"""Share of second echoes that no sonar exceeds."""


def has_commands(flight: Flight) -> bool:
    """Return whether the flight has a command log."""
    return flight.command is not None and len(flight.command.stamps_s) > 0


def readings_span_s(flight: Flight) -> tuple[float, float] | None:
    """Return the stamps of the first reading and the last; None where there are none."""
    streams = [s for s in (flight.imu, flight.attitude, flight.velocity, flight.sonar) if s is not None]
    stamps = [s.stamps_s for s in streams if len(s.stamps_s)]
    return (min(float(s[0]) for s in stamps), max(float(s[-1]) for s in stamps)) if stamps else None


def log_apart(flight: Flight) -> str:
    """Describe a command log that is not of the readings' time; empty where it is, or where either is
    missing."""
    span_s = readings_span_s(flight)
    if flight.command is None or not has_commands(flight) or span_s is None:
        return ""
    (begin, end), stamps = span_s, flight.command.stamps_s
    if stamps[0] > end or stamps[-1] < begin:
        away = stamps[0] - end if stamps[0] > end else begin - stamps[-1]
        return f"the command log is on another clock: {away:.0f} s away from the readings"
    if not ((stamps >= begin - AROUND_S) & (stamps <= end)).any():
        return "the command log is empty while there are readings"
    return ""


def has_stick_motion(flight: Flight) -> bool:
    """Return whether the stick moves while there are readings."""
    span_s = readings_span_s(flight)
    if flight.command is None or span_s is None:
        return False
    stamps = flight.command.stamps_s
    during = (stamps >= span_s[0] - AROUND_S) & (stamps <= span_s[1] + AROUND_S)
    return bool((np.abs(np.nan_to_num(flight.command.stick[during])) >= LEAST_STICK).any())


def holds_heading(stick: Stick) -> bool:
    """Return whether a controller moves the turn stick, rather than a hand or a script.

    A controller that knows more of the heading than the instruments puts that knowledge into the stick. It
    then looks like an effect of the stick on the rate of turn. The simulator's waypoint pilot knows the
    truth.
    """
    turn = stick.values[:, TURN]
    return len(turn) > 1 and float(np.mean(np.diff(turn) != 0)) > CONTROLLER_SHARE


def is_calm(flight: Flight) -> bool:
    """Return whether tilt (or else speed) and height stay within the ranges of a hover. If not, the vehicle
    obeyed commands that were not logged. Without tilt and speed it is not known to be calm."""
    level = [
        (flight.attitude.roll_pitch_yaw_rad[:, :2], CALM_RAD) if flight.attitude is not None else None,
        (flight.velocity.v_m_s[:, :2], CALM_M_S) if flight.velocity is not None else None,
    ]
    steady = next((known for known in level if known is not None), None)
    if steady is None or _spread(steady[0]) >= steady[1]:
        return False
    return flight.sonar is None or not _spread(flight.sonar.range_m[:, None], ECHOES) >= CALM_M


def unanswered(flight: Flight) -> str:
    """Describe sticks that move while the tilt does not; empty where it does, or where either is missing."""
    if flight.command is None or flight.attitude is None or not has_stick_motion(flight):
        return ""
    stick, tilt_rad = _spread(flight.command.stick[:, :2]), _spread(flight.attitude.roll_pitch_yaw_rad[:, :2])
    if not (LEAST_STICK <= stick < np.inf and tilt_rad < UNANSWERED_RAD * stick):
        return ""
    return (
        f"the vehicle stands: the sticks move by {stick:.2f}, and its tilt by {np.degrees(tilt_rad):.2f} deg"
    )


def is_aloft(flight: Flight) -> bool:
    """Return whether a sonar shows that the vehicle flies: on the floor it is too near to see."""
    return flight.sonar is not None and bool(np.isfinite(flight.sonar.range_m).mean() > 0.5)


def _spread(values: Array, tail: float = 0.01) -> float:
    """Return the greatest range over columns between the quantiles ``tail`` and 1 - ``tail``; infinite for
    too few rows."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < FEWEST_READINGS:
        return np.inf
    return float(np.max(np.ptp(np.quantile(values, [tail, 1.0 - tail], axis=0), axis=0)))
