"""Attitudes by which the camera looks at the sky are no attitudes of pictures of the floor."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.flight import AttitudeSeries, Flight
from slam.mapping.floor_visibility import without_horizon_frames

CAMERA = Camera((150.0, 150.0), (87.5, 71.5), (176, 144), b_T_c=NADIR_B_T_C)


def flight(*angles) -> Flight:
    return Flight("made", attitude=AttitudeSeries(np.arange(float(len(angles))), np.array(angles, float)))


def test_what_looks_down_is_left_alone():
    made = flight((0.1, -0.2, 3.0), (1.2, 0.0, -9.0), (np.nan, 0.0, 0.0), (0.0, -1.2, 0.0))
    assert without_horizon_frames(made, CAMERA) is made
    assert without_horizon_frames(Flight("bare"), CAMERA).attitude is None


@pytest.mark.parametrize("away", [(1.5, 0.0), (0.0, -1.5), (3.1, 0.0), (1.0, 1.3)])
def test_what_looks_away_is_left_out_and_counted(away):
    found = without_horizon_frames(flight((0.1, -0.2, 0.3), (*away, 0.3)), CAMERA)
    assert found.attitude.roll_pitch_yaw_rad[0] == pytest.approx((0.1, -0.2, 0.3))
    assert np.isnan(found.attitude.roll_pitch_yaw_rad[1]).all()
    assert any("according to 1 of 2 readings" in line for line in found.warnings)


def test_an_attitude_upside_down_throughout_is_like_none():
    assert without_horizon_frames(flight(*[(3.1, 0.0, 0.0)] * 4), CAMERA).attitude is None
