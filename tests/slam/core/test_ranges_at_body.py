"""Ranges of a displaced and tilted sonar are converted to those of a sonar at the body's origin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.core.ranges_at_body import ranges_at_body
from slam.core.streams import AttitudeSeries, Sonar


def flown(b_T_s: np.ndarray, attitude: bool = True) -> tuple[Flight, np.ndarray]:
    """A swaying flight over a floor, and the ranges from the body's origin."""
    times = np.arange(0, 10, 0.05)
    angles = np.column_stack([0.2 * np.sin(times), 0.15 * np.cos(1.3 * times), 0.5 * times])
    if not attitude:
        angles[:] = 0
    w_T_b = np.tile(np.eye(4), (len(times), 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    w_T_b[:, 2, 3] = 1.0 + 0.3 * np.sin(0.7 * times)
    w_T_s = w_T_b @ b_T_s
    series = AttitudeSeries(times, angles) if attitude else None
    sonar = Sonar(times, w_T_s[:, 2, 3] / w_T_s[:, 2, 2], max_range_m=6.0, b_T_s=b_T_s)
    return Flight("made", sonar=sonar, attitude=series), w_T_b[:, 2, 3] / w_T_b[:, 2, 2]


@pytest.mark.parametrize("attitude", [True, False])
def test_the_lever_arm_is_removed(attitude):
    b_T_s = np.eye(4)
    b_T_s[:3, :3] = Rotation.from_euler("xy", [0.1, -0.05]).as_matrix()
    b_T_s[:3, 3] = (0.1, -0.05, -0.08)
    flight, expected = flown(b_T_s, attitude)
    moved = ranges_at_body(flight).sonar
    assert moved.range_m == pytest.approx(expected, rel=1e-9)
    assert np.array_equal(moved.b_T_s, np.eye(4))
    assert moved.max_range_m == pytest.approx(flight.sonar.max_range_m + 0.08)


def test_missing_ranges_stay_missing_and_an_identity_mount_changes_nothing():
    flight, _ = flown(np.eye(4))
    assert ranges_at_body(flight) is flight
    b_T_s = np.eye(4)
    b_T_s[2, 3] = -0.1
    flight, _ = flown(b_T_s)
    flight.sonar.range_m[3], flight.sonar.range_m[5] = np.nan, flight.sonar.max_range_m + 1
    assert np.flatnonzero(np.isnan(ranges_at_body(flight).sonar.range_m)).tolist() == [3, 5]
