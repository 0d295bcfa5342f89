"""Why a barometer cannot tell the lengths of a map."""

from __future__ import annotations

import numpy as np
import pytest

from backend.measurements import BarometerHeight
from slam.mapping.calibration.fallback_scale import falls_where_the_camera_climbs


@pytest.mark.parametrize(
    ("sign", "noise_m", "falls"),
    [(1.0, 0.1, False), (-1.0, 0.1, True), (-1.0, 5.0, False), (0.0, 0.1, False)],
)
def test_a_turned_sign_is_told_from_noise(sign, noise_m, falls):
    rng = np.random.default_rng(2)
    w_T_b = np.tile(np.eye(4), (30, 1, 1))
    w_T_b[:, 2, 3] = 2 + np.sin(np.arange(30) / 3)
    read = 400 + sign * w_T_b[:, 2, 3] + rng.normal(0, noise_m, 30)
    heights = [BarometerHeight(k, float(value), noise_m) for k, value in enumerate(read)]
    assert falls_where_the_camera_climbs(heights, w_T_b) is falls
    assert not falls_where_the_camera_climbs(heights[:3], w_T_b)
