"""A barometer whose heights change by another factor than those of the map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from backend.measurements import BarometerHeight
from slam.core.messages import Kind
from slam.mapping.calibration.barometer_errors import barometer_warning

N = 60
Z_M = 2 + 0.3 * np.sin(np.arange(N) / 3)


def warning(read_m: np.ndarray, z_m: np.ndarray = Z_M, z_std_m: float = 0.005, std_m: float = 0.1) -> str:
    """The line about heights (n,) that were read beside those of a map."""
    w_T_b = np.tile(np.eye(4), (len(z_m), 1, 1))
    w_T_b[:, 2, 3] = z_m
    heights = tuple(BarometerHeight(k, float(value), std_m) for k, value in enumerate(read_m))
    optimum = SimpleNamespace(problem=SimpleNamespace(measurements=SimpleNamespace(heights=heights)))
    covariances = np.tile(z_std_m**2 * np.eye(6), (len(z_m), 1, 1))
    bundle = SimpleNamespace(
        uses_barometer=True, w_T_b=w_T_b, optimum=optimum, over_floor_covariances=covariances
    )
    return barometer_warning(bundle)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("gain", "noise_m", "told"), [(3.28, 0.1, True), (1.0, 0.1, False), (1.2, 0.1, False), (1.0, 9.0, False)]
)
def test_heights_in_feet_are_told(gain, noise_m, told):
    read_m = 400 + gain * Z_M + np.random.default_rng(3).normal(0, noise_m, N)
    line = warning(read_m)
    assert str(line).startswith("barometer0: its heights change 3.3 ±") is told
    assert bool(line) is told
    assert line is None or line.kind is not Kind.NOTE, "somebody has to look at the unit"
    assert barometer_warning(None) is None


@pytest.mark.parametrize("level_m", np.arange(400.0, 401.0, 0.1))
def test_a_coarse_barometer_at_a_hover_is_no_other_unit(level_m):
    """Rounded to metres it reads one or two values, wherever its zero lies."""
    assert warning(np.round(level_m + Z_M), std_m=0.01) is None


def test_heights_in_feet_are_told_though_they_are_rounded():
    read_m = np.round(400 + 3.28 * 5 * Z_M)
    assert str(warning(read_m, 5 * Z_M)).startswith("barometer0: its heights change 3.")


def test_a_level_flight_shows_no_gain():
    """What the map's heights change then is their own noise."""
    rng = np.random.default_rng(5)
    true_m, noise_m = rng.normal(0, 0.01, N), rng.normal(0, 0.02, N)
    assert warning(400 + true_m, true_m + noise_m, z_std_m=0.02, std_m=0.001) is None
    assert warning(400 + true_m, true_m + noise_m, z_std_m=0.001, std_m=0.001)
