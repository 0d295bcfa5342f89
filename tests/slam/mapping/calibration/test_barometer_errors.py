"""A barometer whose heights change by another factor than those of the map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from backend.measurements import BarometerHeight
from slam.mapping.calibration.barometer_errors import barometer_warning


@pytest.mark.parametrize(
    ("gain", "noise_m", "told"), [(3.28, 0.1, True), (1.0, 0.1, False), (1.2, 0.1, False), (1.0, 9.0, False)]
)
def test_heights_in_feet_are_told(gain, noise_m, told):
    rng = np.random.default_rng(3)
    w_T_b = np.tile(np.eye(4), (60, 1, 1))
    w_T_b[:, 2, 3] = 2 + 0.3 * np.sin(np.arange(60) / 3)
    read = 400 + gain * w_T_b[:, 2, 3] + rng.normal(0, noise_m, 60)
    heights = tuple(BarometerHeight(k, float(value), 0.1) for k, value in enumerate(read))
    measured = SimpleNamespace(heights=heights)
    optimum = SimpleNamespace(problem=SimpleNamespace(measurements=measured))
    bundle = SimpleNamespace(uses_barometer=True, w_T_b=w_T_b, optimum=optimum)
    line = barometer_warning(bundle)  # type: ignore[arg-type]
    assert line.startswith("barometer0: its heights change 3.3 ±") is told
    assert bool(line) is told
    assert barometer_warning(None) == ""
