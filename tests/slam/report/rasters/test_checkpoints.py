"""Jobs on the pictures of a mosaic behind a kill: those that are known read no picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import MosaicPlan, plan_mosaic
from frontend.mosaic.render import measure_exposure, render_tiles
from slam.core.packing import digest_of, pack
from slam.core.streams import Frames
from slam.io.checkpoint_file import CheckpointFile
from slam.report.rasters.checkpoints import JobCheckpoints
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, photograph, pose, smooth_floor

POSES = np.array([pose(0.8 * k, 0.1 * k, 2.0) for k in range(2)])


@pytest.fixture(scope="module")
def plan() -> MosaicPlan:
    return plan_mosaic(CAMERA, POSES, FLOOR_Z_M, gsd_m=0.04)


class Photographs:
    """Loader that counts what it reads."""

    def __init__(self) -> None:
        self.read: list[int] = []
        self.pictures = [photograph(smooth_floor(1), CAMERA, w_T_b) for w_T_b in POSES]

    def __call__(self, k: int) -> np.ndarray:
        self.read.append(k)
        return self.pictures[k]

    def content_key(self, k: int) -> bytes:
        return digest_of(self.pictures[k])


@pytest.fixture
def load() -> Photographs:
    return Photographs()


def drawn(plan: MosaicPlan, load: Photographs, path: Path, said: list[str]) -> bytes:
    frames = Frames(np.arange(2.0), ("a", "b"), load)
    load.read.clear()
    with CheckpointFile(path, {}, say=said.append) as file:
        pictures = Pictures(plan, load, checkpoints=JobCheckpoints(file, frames, np.arange(2)))
        exposure = measure_exposure(plan, pictures)
        tiles = list(render_tiles(plan, pictures, exposure))
    return pack((exposure, [(tile.rgba, tile.fingerprint, tile.reused) for tile in tiles]))


def test_the_second_run_reads_no_picture_and_draws_the_same(plan, load, tmp_path):
    said: list[str] = []
    first = drawn(plan, load, tmp_path / "checkpoint", said)
    assert set(load.read) == {0, 1}
    assert said == []
    assert drawn(plan, load, tmp_path / "checkpoint", said) == first
    assert load.read == []
    assert [line.split("mosaic's ")[1] for line in said] == ["exposure are known", "tiles are known"]


def test_another_plan_or_another_picture_is_drawn_anew(plan, load, tmp_path):
    first, said = drawn(plan, load, tmp_path / "checkpoint", []), []
    load.pictures[1] = load.pictures[1] // 2
    assert drawn(plan, load, tmp_path / "checkpoint", said) != first
    drawn(replace(plan, floor_z_m=FLOOR_Z_M - 0.1), load, tmp_path / "checkpoint", said)
    assert said == []


def test_a_result_is_known_to_its_stage_with_the_same_inputs_alone(plan, load, tmp_path):
    with CheckpointFile(tmp_path / "checkpoint", {}) as file:
        jobs = JobCheckpoints(file, Frames(np.arange(2.0), ("a", "b"), load), np.arange(2))
        jobs.stage("surface", plan, 4).keep(0, "found")
        assert jobs.stage("surface", plan, 4).recall(0) == "found"
        for other in (jobs.stage("tiles", plan, 4), jobs.stage("surface", plan, 5)):
            assert other.recall(0) is None
        assert jobs.stage("surface", plan, 4).recall(1) is None
