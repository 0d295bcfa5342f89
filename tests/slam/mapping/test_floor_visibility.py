"""What looks at the sky: attitudes that are none of pictures of the floor, and parts of pictures."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Frames
from slam.mapping import floor_visibility
from slam.mapping.floor_visibility import horizon_masks, joined, without_horizon_frames
from slam.mapping.keyframe_readings import REACH_S, attitudes_at
from slam.mapping.obstacles import no_masks

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


def seen(*angles) -> Flight:
    made = flight(*angles)
    frames = Frames(made.attitude.stamps_s, tuple(map(str, range(len(angles)))), lambda frame: None)
    return Flight("made", attitude=made.attitude, frames=frames)


def test_what_lies_near_the_horizon_or_above_it_is_hidden():
    """The camera looks 65 degrees ahead: what is 80 degrees off straight down is 15 degrees over its axis."""
    mask = horizon_masks(seen((0.0, 0.0, 0.5), (0.0, np.radians(-65), 0.5), (np.nan, 0.0, 0.0)), CAMERA)
    assert mask(0) is None
    assert mask(2) is None
    row = CAMERA.center_px[1] - CAMERA.focal_px[1] * np.tan(np.radians(15))
    shown = mask(1)
    assert shown.shape == CAMERA.size_px[::-1]
    assert not shown[: int(row) - 3, 87].any()
    assert shown[int(row) + 4 :, 87].all()


def test_pictures_without_a_horizon_are_looked_at_as_a_whole():
    assert horizon_masks(seen((0.1, -0.5, 0.0), (0.3, 0.2, 0.0)), CAMERA) is no_masks
    assert horizon_masks(Flight("bare"), CAMERA) is no_masks


def test_only_pictures_near_a_view_of_the_horizon_are_asked_for_their_attitude(monkeypatch):
    """An hour of video has 100 000 of them, and its attitude a million readings."""
    stamps_s, frames_s = np.arange(0, 250, 0.005), np.arange(0, 250, 1 / 30)
    angles = np.zeros((len(stamps_s), 3))
    angles[(stamps_s > 100) & (stamps_s < 101), 1] = np.radians(-65)
    attitude, asked = AttitudeSeries(stamps_s, angles), []

    def counted(series, at_s, floor_std_rad):
        asked.append(len(at_s))
        return attitudes_at(series, at_s, floor_std_rad)

    monkeypatch.setattr(floor_visibility, "attitudes_at", counted)
    frames = Frames(frames_s, tuple(map(str, range(len(frames_s)))), lambda frame: None)
    tracemalloc.start()
    mask = horizon_masks(Flight("made", attitude=attitude, frames=frames), CAMERA)
    peak_mb = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    assert [frame for frame, at_s in enumerate(frames_s) if mask(frame) is not None] == [
        frame for frame, at_s in enumerate(frames_s) if 100 < at_s < 101
    ]
    assert sum(asked) < 30 * (1 + 2 * REACH_S) + 2
    assert peak_mb < 20


def test_either_of_two_masks_hides():
    left, right = np.array([[0, 255, 255]], np.uint8), np.array([[255, 255, 0]], np.uint8)
    both = joined(lambda frame: left, lambda frame: right if frame else None)
    assert both(0).tolist() == left.tolist()
    assert both(1).tolist() == [[0, 255, 0]]
    assert joined(no_masks, no_masks)(0) is None
