"""What a healthy vehicle makes of a flight, the same for every belief about it.

Beliefs differ in where they have the vehicle and when it obeys. Were each to say for itself which readings a
landing spoils, and were one that is not judged to weigh nothing, a belief would gain by what it leaves out.
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
"""The landing gear differs from vehicle to vehicle: so long after the floor, what feels it is not judged."""
REACH_M = 0.08
"""Heights may be off by a sonar's zero: contact may come so much earlier."""


def referred(record: Record, setting: FilterParameters) -> Record:
    """The record with where it lands, and how surely its channels are foretold, under ``setting``."""
    landed = replace(record, landing=_landing(record, setting), usual_log_variance=np.zeros(len(CHANNELS)))
    return replace(landed, usual_log_variance=_usual(landed, whole(landed, setting)))


def _landing(record: Record, setting: FilterParameters) -> NDArray[np.bool_]:
    """(events,) by a run without accelerometer: the shock of contact must not move the height."""
    values = record.values.copy()
    values[record.kinds == IMU, 3:6] = np.nan
    states = whole(replace(record, values=values), setting).states
    low = states[:, Z] - setting.parameters[GEAR] < REACH_M + 3.0 * states[:, Z_STD]
    sinks = record.stick.at(record.times_s, setting.latency_s)[:, UP] <= 0.0
    # Standing counts as well: the gear is so stiff that a hair's breadth of height shakes the accelerometer.
    last = np.maximum.accumulate(np.where(low & sinks, record.times_s, -np.inf))
    return np.asarray(record.times_s - last < CONTACT_S)


def _usual(record: Record, run: FilterPass) -> NDArray[np.float64]:
    """(channels,) median of the logarithm of the innovation's variance; 0 where there is none."""
    usual = np.zeros(len(CHANNELS))
    channels = np.where(run.status == USED, CHANNEL_AT[record.kinds], NO_CHANNEL)
    for channel in range(len(CHANNELS)):
        found = run.log_variance[channels == channel]
        usual[channel] = np.median(found) if len(found) else 0.0
    return usual


def recoloured(record: Record, before: FilterParameters, after: FilterParameters) -> Record:
    """The record as referred to a belief of another colour: the sample before foretells what it keeps."""
    share = np.log1p(-(after.noise_correlation**2)) - np.log1p(-(before.noise_correlation**2))
    return replace(record, usual_log_variance=record.usual_log_variance + share[list(INSTRUMENT_OF)])
