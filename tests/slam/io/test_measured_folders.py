"""Folders of flights that were measured with real vehicles."""

import os
from pathlib import Path

import numpy as np
import pytest

from slam.core.streams import (
    STREAMS,
)
from slam.io.flight_folder import read_flight

DATA = os.environ.get("SLAM_DATA")


def flights():
    if not DATA:
        return []
    roots = [*Path(DATA, "flights").rglob("mav0"), *Path(DATA, "blind-dev/cases").glob("*/*/mav0")]
    return sorted(str(p.parent.relative_to(DATA)) for p in roots)


@pytest.mark.slow
@pytest.mark.skipif(not DATA, reason="SLAM_DATA is not set")
def test_measured_flights_read(tmp_path):
    assert len(flights()) > 10
    for name in flights():
        flight = read_flight(Path(DATA, name))
        known = [getattr(flight, f) for f in STREAMS if getattr(flight, f) is not None]
        assert known, name
        for series in known:
            assert (np.diff(series.stamps_s) > 0).all(), name
        assert min(s.stamps_s[0] for s in known) == 0.0
        expected = ("not a stream", "treated as missing: at or beyond max_range")
        assert all(any(t in w for t in expected) for w in flight.warnings), (name, flight.warnings)


@pytest.mark.skipif(not DATA, reason="SLAM_DATA is not set")
def test_measured_flight_against_a_plain_reader():
    """numpy's own csv reader as the oracle for one measured flight."""
    folder = Path(DATA, "flights/ardrone2-hybrid")
    flight = read_flight(folder)
    raw = np.genfromtxt(folder / "mav0/sonar0/data.csv", delimiter=",", skip_header=1)
    np.testing.assert_array_equal(flight.sonar.range_m, raw[:, 1])
    raw = np.genfromtxt(folder / "mav0/imu0/data.csv", delimiter=",", skip_header=1)
    np.testing.assert_array_equal(np.hstack([flight.imu.gyro_rad_s, flight.imu.accel_m_s2]), raw[:, 1:])
    first = (folder / "mav0/state_groundtruth_estimate0/data.csv").read_text().splitlines()[1]
    assert flight.epoch_ns == int(first.split(",")[0])
    assert flight.frames[0].read().shape == (144, 176, 3)
    assert set(flight.landmarks) == set("ABCDEFGH")
