"""Landing times and usual innovation variances of a flight, the same for all parameter sets.

Parameter sets differ in the vehicle's path and in its delay. If each of them chose which readings a landing
spoils, and an ignored reading counted as nothing, a model would gain by leaving readings out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.filter import USED, Z_STD
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import FilterPass, whole
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS, IMU, INSTRUMENT_OF, NO_CHANNEL
from slam.criticism.kalman.record import Record
from slam.simulation.dynamics import GEAR, UP, Z

CONTACT_S = 0.3
"""Time after floor contact in which readings are not used, since landing gears differ."""
REACH_M = 0.08
"""Margin of the contact height: the sonar's zero may be wrong by so much."""


def referred(record: Record, parameters: FilterParameters) -> Record:
    """Return the record with its landing times and usual innovation variances under ``parameters``."""
    landed = replace(record, landing=_landing(record, parameters), usual_log_variance=np.zeros(len(CHANNELS)))
    return replace(landed, usual_log_variance=_usual(landed, whole(landed, parameters)))


def _landing(record: Record, parameters: FilterParameters) -> NDArray[np.bool_]:
    """Return (events,) landing; run without accelerometer, as the contact shock must not move the height."""
    values = record.values.copy()
    values[record.kinds == IMU, 3:6] = np.nan
    states = whole(replace(record, values=values), parameters).states
    low = states[:, Z] - parameters.dynamics[GEAR] < REACH_M + 3.0 * states[:, Z_STD]
    sinks = record.stick.at(record.times_s, parameters.latency_s)[:, UP] <= 0.0
    # Standing counts as well: the gear is so stiff that a tiny height error shows in the accelerometer.
    last = np.maximum.accumulate(np.where(low & sinks, record.times_s, -np.inf))
    return np.asarray(record.times_s - last < CONTACT_S)


def _usual(record: Record, run: FilterPass) -> NDArray[np.float64]:
    """Return (channels,) the median log variance of the innovations; 0 for a channel without any."""
    usual = np.zeros(len(CHANNELS))
    channels = np.where(run.status == USED, CHANNEL_AT[record.kinds], NO_CHANNEL)
    for channel in range(len(CHANNELS)):
        found = run.log_variance[channels == channel]
        usual[channel] = np.median(found) if len(found) else 0.0
    return usual


def recoloured(record: Record, before: FilterParameters, after: FilterParameters) -> Record:
    """Return the record as ``referred`` would for other AR(1) coefficients of the noise."""
    share = np.log1p(-(after.noise_correlation**2)) - np.log1p(-(before.noise_correlation**2))
    return replace(record, usual_log_variance=record.usual_log_variance + share[list(INSTRUMENT_OF)])
