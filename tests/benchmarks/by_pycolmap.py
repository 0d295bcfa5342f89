"""Structure from motion by pycolmap on the CPU: pairs of pictures, incremental mapping.

``python -m tests.benchmarks.by_pycolmap PICTURES NAMES SETTINGS`` maps some pictures of a folder and prints
times, peak memory and poses as JSON. It imports nothing of ours, so that the memory is pycolmap's.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.apart import Took, run_apart, timed
from tests.benchmarks.metric import Metric, Skipped, at_most

if TYPE_CHECKING:
    from frontend.camera import Camera
    from frontend.features import FeatureConfig

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
MOST_MEMORY = 1.0
"""Wanted share of its peak memory."""


@dataclass(frozen=True)
class Mapped:
    """Result of some pictures."""

    seconds: float
    cpu_s: float
    c_T_w: dict[str, Array]
    """Poses (3, 4) by file name, of the pictures in the largest model, whose scale is arbitrary."""
    models: int
    peak_mb: float
    """Peak resident memory of its process."""

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
    """Map a folder with a known camera in a separate process; None after a time-out.

    Raises ``Skipped`` where the package is missing.
    """
    distortion = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    known = Settings(camera=(*camera.focal_px, *camera.center_px, *distortion))
    return _apart(pictures, sorted(path.name for path in pictures.iterdir()), known, limit_s)


def mapped(pictures: Path, names: list[str], settings: Settings) -> Mapped:
    """Map some pictures of a folder in a separate process.

    Raises ``Skipped`` where the package is missing.
    """
    found = _apart(pictures, names, settings, None)
    assert found is not None
    return found


def _apart(pictures: Path, names: list[str], settings: Settings, limit_s: float | None) -> Mapped | None:
    if find_spec("pycolmap") is None:
        raise Skipped("pycolmap is not installed (pip install --group bench)")
    told = json.dumps(names), json.dumps(asdict(settings))
    found = run_apart("tests.benchmarks.by_pycolmap", pictures, *told, limit_s=limit_s)
    if found is None:
        return None
    return Mapped(**{**found, "c_T_w": {name: np.array(pose) for name, pose in found["c_T_w"].items()}})


def _mapped(pictures: Path, names: list[str], settings: Settings) -> Mapped:
    """Map some pictures of a folder in this process."""
    import pycolmap

    colmap: Any = pycolmap
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
    seconds, cpu_s, memory_mb = took[0].seconds, took[0].cpu_s, took[0].peak_mb
    if not models:
        return Mapped(seconds, cpu_s, {}, 0, memory_mb)
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    poses = {
        image.name: image.cam_from_world().matrix() for image in largest.images.values() if image.has_pose
    }
    return Mapped(seconds, cpu_s, poses, len(models), memory_mb)


def against_best(ours: Took, best: Mapped, of: int) -> list[Metric]:
    """Return our times and memory over those of pycolmap at its best, which had ``of`` photographs.

    Both had a process of its own, of which ``ours`` was the first large job.
    """
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
    ] + [
        at_most(
            f"our peak memory over {title}", ours.peak_mb / best.peak_mb, "x", MOST_MEMORY,
            f"{ours.peak_mb:.0f} MB over {best.peak_mb:.0f} MB, each in a process of its own",
        )
    ]  # fmt: skip


def main(pictures: str, names: str, settings: str) -> None:
    """Run the separate process."""
    done = _mapped(Path(pictures), json.loads(names), Settings(**json.loads(settings)))
    poses = {name: pose.tolist() for name, pose in done.c_T_w.items()}
    print(json.dumps({**vars(done), "c_T_w": poses}))


if __name__ == "__main__":
    main(*sys.argv[1:])
