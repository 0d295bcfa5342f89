"""Pictures of a mosaic on disk."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace

import numpy as np
import pytest

from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.scratch import PictureScratch
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, photograph, smooth_floor, survey

PICTURES = [np.random.default_rng(k).integers(0, 256, (30, 40, 3), np.uint8) for k in range(3)]
MB = PICTURES[0].nbytes / 1e6


def test_kept_pictures_come_back_by_pose_and_size_as_far_as_there_is_room() -> None:
    scratch = PictureScratch(most_mb=2.5 * MB)
    for k, picture in enumerate(PICTURES):
        assert scratch.recall(k, (40, 30)) is None
        scratch.keep(k, picture)
    for k in (1, 0):
        np.testing.assert_array_equal(scratch.recall(k, (40, 30)), PICTURES[k])
    assert scratch.recall(0, (30, 40)) is None
    assert scratch.recall(2, (40, 30)) is None


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), FileNotFoundError()])
def test_without_a_disk_to_write_on_nothing_is_kept(monkeypatch, error) -> None:
    def refuse(*inputs, **named):
        raise error

    scratch = PictureScratch(most_mb=100)
    no_folder = isinstance(error, FileNotFoundError)  # of tempfile
    monkeypatch.setattr(*((tempfile, "TemporaryFile") if no_folder else (os, "pwrite")), refuse)
    for k, picture in enumerate(PICTURES):
        scratch.keep(k, picture)
        assert scratch.recall(k, (40, 30)) is None


def test_a_picture_is_read_once_for_all_plans_though_memory_holds_one() -> None:
    floor, poses = smooth_floor(1), survey(3)
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    read = list[int]()

    def load(k: int) -> np.ndarray:
        read.append(k)
        return photograph(floor, CAMERA, poses[k])

    pictures = Pictures(plan, load, max_mb=0.001, scratch=PictureScratch(most_mb=100))
    first = [pictures[index] for index in range(len(plan.views))]
    other = pictures.over(replace(plan, views=plan.views[::-1]))
    for index, picture in enumerate(first):
        there = len(first) - 1 - index
        np.testing.assert_array_equal(pictures[index], picture)
        np.testing.assert_array_equal(other[there], picture)
        assert other.digest(there) == pictures.digest(index)
    assert read == [view.k for view in plan.views]
