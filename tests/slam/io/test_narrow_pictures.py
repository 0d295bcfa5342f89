"""Reduced pictures, with the camera that took them."""

from __future__ import annotations

import numpy as np
import pytest

from slam.evaluation.association import poses_at
from slam.io.narrow_pictures import with_narrow_pictures
from tests.slam.small_flight import flown, seeing


@pytest.fixture(scope="module")
def flight():
    return flown(0)


def test_a_floor_point_is_where_the_reduced_picture_shows_it(flight):
    """The camera of the reduced picture maps the middle of a block of pixels to that of the block's pixel."""
    narrow = with_narrow_pictures(flight, 88, "")
    assert narrow.camera.size_px == (88, 72)
    blocks = np.array([[10.5, 20.5], [100.5, 4.5], [170.5, 140.5]])  # middles of blocks of 2 x 2
    pose = poses_at(flight.truth, flight.frames.stamps_s[:1])[0]
    np.testing.assert_allclose(
        narrow.camera.floor_points(pose, (blocks - 0.5) / 2),
        flight.camera.floor_points(pose, blocks),
        atol=1e-12,
    )
    whole = flight.frames.load(0).astype(float).reshape(72, 2, 88, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(narrow.frames.load(0), whole, atol=0.51)


def test_the_flight_says_so(flight):
    line = with_narrow_pictures(flight, 88, ", so that tracking keeps pace").warnings[-1]
    assert line == "cam0: pictures reduced from 176 x 144 to 88 x 72 pixels, so that tracking keeps pace"
    assert with_narrow_pictures(flight, 176, "") is flight


def test_a_damaged_picture_and_one_of_another_size_stay_what_they_are(flight):
    other = np.zeros((10, 12), np.uint8)
    narrow = with_narrow_pictures(seeing(flight, lambda k: other if k else None), 88, "")
    assert narrow.frames.load(0) is None
    assert narrow.frames.load(1) is other
