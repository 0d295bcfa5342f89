"""An accelerometer that reads another gravity: an offset, or lengths that are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.problem import ScalePrior
from backend.inertial_scale.scale import InertialScale
from backend.measurements import GRAVITY_M_S2
from slam.core.imu_at_rest import GravityReading
from slam.core.messages import Kind
from slam.mapping.calibration.inertial_scale import AccelerometerScale
from slam.mapping.warnings.gravity_reading import expected_length_error, judged

UP = np.array([0.0, 0.0, 1.0])


def reading(accel_m_s2: float, b_up: np.ndarray = UP) -> GravityReading:
    return GravityReading(accel_m_s2, b_up, at_rest=True)


def test_the_expected_error_is_the_mean_of_drawn_sensors_that_read_so() -> None:
    """Of many sensors with gain and offset drawn as the map assumes, those that read 9.04 at rest."""
    rng = np.random.default_rng(4)
    gain, offset = rng.normal(0, 0.02, 4_000_000), rng.normal(0, 0.3, 4_000_000)
    alike = gain[np.abs(GRAVITY_M_S2 * (1 + gain) + offset - 9.04) < 0.02]
    slopes = (0.0, 0.0, 0.4)
    found = expected_length_error(reading(9.04), slopes, 0.02, 0.3)
    assert found == pytest.approx(abs(0.4 * alike.mean()), rel=0.03)


def test_only_the_axes_along_gravity_count() -> None:
    slopes = (0.9, 0.0, 0.1)
    upright = expected_length_error(reading(9.0), slopes, 0.02, 0.3)
    turned = expected_length_error(reading(9.0, np.array([1.0, 0, 0])), slopes, 0.02, 0.3)
    assert turned == pytest.approx(9 * upright)
    assert expected_length_error(reading(9.0), slopes, 1e-9, 0.3) == pytest.approx(0, abs=1e-12)


def test_lengths_of_a_map_follow_the_accelerometer_by_its_share() -> None:
    """They are the weighted mean of two measurements, as least squares have it: here of a range and of an
    accelerometer that is 1.4 % wrong."""
    found = InertialScale(1.0, 0.01, *((0.0,) * 3, (0.1,) * 3) * 2, (0.0, 0.0, 0.6), (0.0,) * 3, (0.1,) * 3)
    alone = AccelerometerScale(found, ScalePrior(1.0, 0.0144), None)
    assert alone.share == 1.0
    weights = 1 / np.array([0.0521, 0.0144])
    (merged,) = np.linalg.lstsq(weights[:, None], weights * [0.0, 0.014], rcond=None)[0]
    beside_ranges = replace(alone, map_std=0.0521)
    assert beside_ranges.share * 0.014 == pytest.approx(merged)


@pytest.mark.parametrize(("stated", "in_status"), [(0.02, False), (0.004, True), (None, True)])
def test_the_status_names_what_exceeds_the_stated_accuracy(stated: float | None, in_status: bool) -> None:
    line = judged(reading(9.04), 0.009, stated)
    assert line.judged.kind is (Kind.REASON if in_status else Kind.NOTE)
    assert ("measure one distance" in str(line.judged)) == in_status
    assert line.raw == reading(9.04).warning
