"""A map that heights on Earth hold, and that leans against the attitude."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries
from slam.mapping.calibration.attitude_floor_tilt import attitude_floor_tilt
from slam.mapping.warnings.lean import lean_warning

STAMPS_S = 4.0 * np.arange(12)


def lean(lean_deg: float, control: bool, georeferenced: bool = True) -> str:
    """The warning of a level map at two headings, whose attitude leans in the world, good to 2 degrees."""
    yaw = np.where(np.arange(12) % 2, np.pi, 0.0)
    w_T_b = np.tile(np.eye(4), (12, 1, 1))
    w_T_b[:, 0, 0] = w_T_b[:, 1, 1] = np.cos(yaw)
    pitch = np.radians(lean_deg) * np.cos(yaw)
    std_rad = tuple(np.radians([2.0, 2.0, 5.0]).tolist())
    attitude = AttitudeSeries(STAMPS_S, np.column_stack([0 * yaw, pitch, yaw]), std_rad)
    measured = SimpleNamespace(control=("P",) if control else ())
    map_ = SimpleNamespace(
        georeferenced=georeferenced,
        bundle=SimpleNamespace(optimum=SimpleNamespace(problem=SimpleNamespace(measurements=measured))),
    )
    flight = Flight("photos", attitude=attitude)
    return str(lean_warning(flight, map_, attitude_floor_tilt(flight, STAMPS_S, w_T_b)) or "")


@pytest.mark.parametrize(("control", "which"), [(True, "control points"), (False, "positions")])
def test_heights_that_tilt_the_map_are_named(control: bool, which: str):
    told = lean(5.7, control)
    assert f"attitude0 leans by 5.7° against the map, which the heights of {which} hold" in told
    assert "check the unit of these heights" in told


def test_a_lean_within_what_the_attitude_states_is_none():
    assert lean(3.0, control=True) == ""
    assert lean(30.0, control=True, georeferenced=False) == ""
