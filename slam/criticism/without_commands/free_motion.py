"""Filter for unknown inputs: the filter's equations with inflated process noise, for flights without
commands.

With so much process noise the equations constrain nothing. The filter gives the motion that all instruments
agree on, and the residual of each reading.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.flight import Flight
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.record import Record, moving_from, record_of
from slam.criticism.kalman.transition import HOLD
from slam.criticism.without_commands.inertial_consistency import near_floor

PROCESS_NOISE = {
    "tilt_std_rad": 0.3, "tilt_time_s": 0.2, "yaw_rate_std_rad_s": 1.5, "yaw_rate_time_s": 0.2,
    "velocity_std_m_s": 1.0, "velocity_time_s": 0.2, "velocity_up_std_m_s": 1.0,
}  # fmt: skip
"""Entries of ``HOLD``: the motion of a hand."""
CLEAR_S = 0.3
"""Least time from a reading near the floor."""
SHORTEST_S = 5.0


def with_free_motion(parameters: FilterParameters) -> FilterParameters:
    """Return the parameters with inflated process noise, which describe the instruments alone."""
    hold = parameters.hold.copy()
    hold[[HOLD.index(name) for name in PROCESS_NOISE]] = list(PROCESS_NOISE.values())
    return replace(parameters, hold=hold)


def airborne_record(flight: Flight) -> Record | None:
    """Return the longest segment between readings near the floor.

    It is None where there is no sonar, where the segment is short, or where fewer than two of imu, attitude
    and velocity measure the motion.
    """
    if flight.sonar is None or [flight.imu, flight.attitude, flight.velocity].count(None) > 1:
        return None
    try:
        record = record_of(flight)
    except ValueError:
        return None
    ends_s = record.times_s[[0, -1]] + CLEAR_S * np.array([-1.0, 1.0])
    low_s = np.concatenate([ends_s[:1], near_floor(flight), ends_s[1:]])
    longest = int(np.argmax(np.diff(low_s)))
    begin_s, end_s = low_s[longest] + CLEAR_S, low_s[longest + 1] - CLEAR_S
    if end_s - begin_s < SHORTEST_S:
        return None
    return moving_from(record, begin_s, end_s)
