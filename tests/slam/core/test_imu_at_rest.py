"""Readings of an accelerometer that hold gravity, or not."""

from __future__ import annotations

import numpy as np
import pytest

from backend.measurements import GRAVITY_M_S2
from slam.core.imu_at_rest import gravity_reading
from slam.core.stream_anomalies import imu_axis_anomalies
from slam.core.streams import Imu


@pytest.mark.parametrize("gravity_m_s2", [0.0, GRAVITY_M_S2])
def test_vibration_is_no_gravity(gravity_m_s2: float) -> None:
    """Its single readings are larger than a quarter of gravity; a lost one is no matter."""
    rng = np.random.default_rng(1)
    accel_m_s2 = rng.normal(0.0, 2.0, (4000, 3)) + [0.0, 0.0, gravity_m_s2]
    accel_m_s2[7] = np.nan
    imu = Imu(np.arange(4000) / 200, np.zeros((4000, 3)), accel_m_s2)
    is_missing = gravity_m_s2 == 0.0
    reading = gravity_reading(imu)
    assert (reading is not None and reading.is_missing) is is_missing
    assert imu_axis_anomalies(imu) == []


def test_no_finite_reading_tells_nothing() -> None:
    imu = Imu(np.arange(9.0), np.zeros((9, 3)), np.full((9, 3), np.nan))
    assert gravity_reading(imu) is None
    assert imu_axis_anomalies(imu) == []
