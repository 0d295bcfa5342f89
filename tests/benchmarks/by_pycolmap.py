"""Structure from motion by pycolmap on the CPU: pairs of pictures, incremental mapping.

``python -m tests.benchmarks.by_pycolmap PICTURES CAMERA`` maps a folder with a known camera (OpenCV's fx, fy,
cx, cy, k1, k2, p1, p2 with commas, pixel (0, 0) the centre of the first); prints seconds and poses as JSON.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import FeatureConfig
from tests.benchmarks.apart import run_apart
from tests.benchmarks.metric import Metric, Skipped, at_most

Array = NDArray[np.float64]

RARE = 1.4
"""Growth of the model until all of it is adjusted again, where its default is 1.1: the quicker of the two."""
NEIGHBOURS = 20
"""Nearest photographs that each is compared with: its default is 50; with 20 all still find their place."""
BEST_SIDE_PX = 1000
"""Longer side of its pictures at its best. At 1400 px its positions are no better: 0.121 m off on isfm with
both, and 2 mm apart on caliterra, for 1.4 and 1.6 times the processor time."""
MOST_OF_BEST = 0.5
"""Wanted share of the time of pycolmap at its best."""


@dataclass(frozen=True)
class Mapped:
    """Result of some pictures."""

    seconds: float
    cpu_s: float
    c_T_w: dict[str, Array]
    """Poses (3, 4) by file name, of the pictures in the largest model, whose scale is arbitrary."""
    models: int

    def centers(self, names: Sequence[str]) -> Array:
        """Return (n, 3) positions of the cameras of placed pictures."""
        poses = [self.c_T_w[name] for name in names]
        return np.array([-pose[:, :3].T @ pose[:, 3] for pose in poses]).reshape(-1, 3)


@dataclass(frozen=True)
class Settings:
    """What pycolmap is told; the defaults are its own, with every pair compared."""

    side_px: int | None = None
    """Pictures are reduced to this side."""
    camera: tuple[float, ...] | None = None
    """OpenCV's fx, fy, cx, cy, k1, k2, p1, p2; None to estimate the lens."""
    free_center: bool = False
    """Whether the lens is OpenCV's with an estimated principal point."""
    quick_features: int | None = None
    """So many features, from the first octave that is not doubled, pairs of neighbours by the positions in
    the tags, and rarer adjustment of the whole."""


def at_its_best(config: FeatureConfig) -> Settings:
    """Return the quickest settings that place the photographs as well as any, with our number of features."""
    return Settings(BEST_SIDE_PX, free_center=True, quick_features=config.for_width(10**6).max_features)


def mapped_apart(pictures: Path, camera: Camera, limit_s: float) -> Mapped | None:
    """Map a folder in a separate process; None after a time-out.

    Raises ``Skipped`` where the package is missing.
    """
    _package()
    distortion = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    known = (*camera.focal_px, *camera.center_px, *distortion)
    found = run_apart("tests.benchmarks.by_pycolmap", pictures, ",".join(map(str, known)), limit_s=limit_s)
    if found is None:
        return None
    poses = {name: np.array(pose) for name, pose in found["c_T_w"].items()}
    return Mapped(found["seconds"], found["cpu_s"], poses, found["models"])


def mapped(pictures: Path, names: list[str], settings: Settings) -> Mapped:
    """Map some pictures of a folder.

    Raises ``Skipped`` where the package is missing.
    """
    colmap = _package()
    colmap.logging.minloglevel = 2
    reader, mapping = colmap.ImageReaderOptions(), colmap.IncrementalPipelineOptions()
    extraction, cpu = colmap.FeatureExtractionOptions(), colmap.Device.cpu
    if settings.side_px is not None:
        extraction.max_image_size = settings.side_px
    if settings.camera is not None:
        # Its pixel (0, 0) is the corner of the first.
        fx, fy, cx, cy, *distortion = settings.camera
        reader.camera_model = "OPENCV"
        reader.camera_params = ",".join(map(str, (fx, fy, cx + 0.5, cy + 0.5, *distortion)))
        mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = False
        mapping.mapper.abs_pose_refine_focal_length = mapping.mapper.abs_pose_refine_extra_params = False
    if settings.free_center:
        reader.camera_model, mapping.ba_refine_principal_point = "OPENCV", True
    if settings.quick_features is not None:
        extraction.sift.max_num_features, extraction.sift.first_octave = settings.quick_features, 0
        mapping.ba_global_frames_ratio = mapping.ba_global_points_ratio = RARE
    with tempfile.TemporaryDirectory() as scratch:
        database = Path(scratch) / "pictures.db"
        with timed() as took:
            colmap.extract_features(
                database, pictures, names, colmap.CameraMode.SINGLE, reader, extraction, device=cpu
            )
            if settings.quick_features is None:
                colmap.match_exhaustive(database, device=cpu)
            else:
                near = colmap.SpatialPairingOptions()
                near.max_num_neighbors = NEIGHBOURS
                colmap.match_spatial(database, pairing_options=near, device=cpu)
            models = colmap.incremental_mapping(database, pictures, Path(scratch), mapping)
    seconds, cpu_s = took[0].seconds, took[0].cpu_s
    if not models:
        return Mapped(seconds, cpu_s, {}, 0)
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    poses = {
        image.name: image.cam_from_world().matrix() for image in largest.images.values() if image.has_pose
    }
    return Mapped(seconds, cpu_s, poses, len(models))


@dataclass(frozen=True)
class Took:
    """Time from pictures to poses."""

    seconds: float
    cpu_s: float


@contextmanager
def timed() -> Iterator[list[Took]]:
    """Give a list that has the time of the block after it."""
    began, cpu_began, took = time.perf_counter(), time.process_time(), list[Took]()
    yield took
    took.append(Took(time.perf_counter() - began, time.process_time() - cpu_began))


def against_best(ours: Took, best: Mapped, of: int) -> list[Metric]:
    """Return our times over those of pycolmap at its best, which had ``of`` photographs."""
    title = "pycolmap's at its best, CPU"
    how = (
        f"{BEST_SIDE_PX} px, our number of features, first octave 0, {NEIGHBOURS} neighbours by GPS, sparse"
        " adjustment"
    )
    placed = f"{how}; it placed {len(best.c_T_w)} of {of}"
    return [
        at_most(
            f"our {name} over {title}", mine / theirs, "x", MOST_OF_BEST,
            f"{mine:.0f} s over {theirs:.0f} s; {placed}",
        )
        for name, mine, theirs in (
            ("processor time", ours.cpu_s, best.cpu_s), ("time", ours.seconds, best.seconds),
        )
    ]  # fmt: skip


def _package() -> Any:
    try:
        import pycolmap
    except ImportError:
        raise Skipped("pycolmap is not installed (pip install --group bench)") from None
    return pycolmap


def main(pictures: Path, camera: str) -> None:
    """Run the separate process."""
    names = sorted(path.name for path in pictures.iterdir())
    done = mapped(pictures, names, Settings(camera=tuple(map(float, camera.split(",")))))
    poses = {name: pose.tolist() for name, pose in done.c_T_w.items()}
    found = {"seconds": done.seconds, "cpu_s": done.cpu_s, "c_T_w": poses, "models": done.models}
    print(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
