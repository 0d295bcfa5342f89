"""Altitudes that drift, or step where the recording pauses, within the accuracy that is assumed."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.units import SPACE
from slam.mapping.gps.altitude_course import AltitudesOnMap, altitude_course


def altitudes(up_m: np.ndarray, seed: int = 0, pause_s: float = 0.0) -> AltitudesOnMap:
    """Altitudes (16,) over four lanes with 2 m of noise; half of them after a pause."""
    n = np.arange(16)
    along = np.where(n // 4 % 2, 3 - n % 4, n % 4)
    up_m = up_m + np.random.default_rng(seed).normal(0, 2.0, 16)
    stamps_s, names = 4.0 * n + pause_s * (n >= 8), [f"P{k:02}" for k in n.tolist()]
    return AltitudesOnMap(up_m, np.column_stack([12.0 * (n // 4), 9.0 * along]), stamps_s, names)


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_is_told_with_its_size(seed):
    line = altitude_course(altitudes(np.linspace(0, 60, 16) ** 1.0, seed), 10.0)
    assert line.startswith("they rise against the pictures by ")
    assert line.endswith("from P00 to P15")


@pytest.mark.parametrize("seed", range(3))
def test_a_step_at_a_pause_is_told_with_its_size_and_photographs(seed):
    line = altitude_course(altitudes(-20.0 * (np.arange(16) >= 8), seed, 1e6), 10.0)
    assert "those from P08 on lie" in line
    assert line.endswith("below those up to P07")
    metres = float(line.replace(SPACE, " ").split(" lie ")[1].split(" m ")[0])
    assert metres == pytest.approx(20, abs=6)


def test_noise_and_small_courses_are_none():
    for seed in range(100):
        assert not altitude_course(altitudes(np.zeros(16), seed), 10.0)
        assert not altitude_course(altitudes(5.0 * (np.arange(16) >= 8), seed, 1e6), 10.0)
    few = altitudes(np.linspace(0, 60, 16))
    assert not altitude_course(
        AltitudesOnMap(few.up_m[:7], few.w_p_m[:7], few.stamps_s[:7], few.names[:7]), 10.0
    )
