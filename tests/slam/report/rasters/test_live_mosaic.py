"""The coarse mosaic of a live map: its content, and what it draws again."""

from __future__ import annotations

import numpy as np
import pytest

from slam.evaluation.association import poses_at
from slam.report.rasters.live_mosaic import LiveMosaic
from tests.slam.small_flight import flown

FRAMES = np.arange(0, 40, 4)


@pytest.fixture(scope="module")
def flight():
    return flown(0)


def test_only_what_changed_is_drawn_again(flight):
    poses, read = poses_at(flight.truth, flight.frames.stamps_s[FRAMES]), []

    def load(frame):
        read.append(frame)
        return flight.frames.load(frame)

    mosaic = LiveMosaic(flight.camera, load)
    first = mosaic.update(FRAMES, poses)
    all_tiles = mosaic.rendered
    assert all_tiles > 1
    assert sorted(read) == sorted(set(read))
    np.testing.assert_array_equal(mosaic.update(FRAMES, poses), first)
    assert mosaic.rendered == 0
    trembling = poses.copy()
    trembling[:, 0, 3] += 1e-4
    mosaic.update(FRAMES, trembling)
    assert mosaic.rendered == 0
    moved = poses.copy()
    moved[0, :3, 3] += [0.0, 0.03, 0.0]
    mosaic.update(FRAMES, moved)
    assert 0 < mosaic.rendered < all_tiles
    assert sorted(read) == sorted(set(read))


def test_it_shows_the_floor_in_its_colours(flight):
    poses = poses_at(flight.truth, flight.frames.stamps_s[FRAMES])
    picture = LiveMosaic(flight.camera, flight.frames.load).update(FRAMES, poses)
    drawn = picture[~(picture == 255).all(axis=2)]
    seen = np.concatenate([flight.frames.load(int(k)).reshape(-1, 3) for k in FRAMES])
    np.testing.assert_allclose(drawn.mean(axis=0), seen.mean(axis=0), atol=8.0)
    np.testing.assert_allclose(drawn.std(axis=0), seen.std(axis=0), rtol=0.25)


def test_without_a_placed_keyframe_there_is_no_picture(flight):
    assert (
        LiveMosaic(flight.camera, flight.frames.load).update(FRAMES[:1], np.full((1, 4, 4), np.nan)) is None
    )
