"""The first guess of where a flight begins."""

from __future__ import annotations

import numpy as np

from slam.core.flight import Flight
from slam.core.streams import Command, Sonar
from slam.criticism.kalman.filter import GATE
from slam.criticism.kalman.record import record_of


def starting(ranges):
    """A record whose sonar begins with these readings."""
    stamps = 0.04 * np.arange(100)
    readings = np.full(100, 0.94)
    readings[: len(ranges)] = ranges
    sonar = Sonar(stamps, readings)
    command = Command(np.array([0.0, 2.0]), np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, 0.0]]), 0.5236)
    return record_of(Flight("start", sonar=sonar, command=command))


def test_a_second_echo_first_is_seen_as_one():
    record = starting([1.88])
    off = abs(record.values[0, 0] - record.start[2])
    assert abs(record.start[2] - 0.94) < 0.02
    assert off > GATE * np.hypot(record.start_std[2], 0.01)


def test_a_start_in_a_climb_is_as_unsure_as_its_readings_spread():
    record = starting([0.74, 0.79, 0.84, 0.89])
    assert abs(0.74 - record.start[2]) < 2.0 * record.start_std[2]
