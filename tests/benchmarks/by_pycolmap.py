"""Structure from motion by pycolmap on the CPU: exhaustive matching, incremental mapping.

``python -m tests.benchmarks.by_pycolmap PICTURES CAMERA`` maps a folder with a known camera (OpenCV's fx, fy,
cx, cy, k1, k2, p1, p2 with commas, pixel (0, 0) the centre of the first); prints seconds and poses as JSON.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from tests.benchmarks.apart import run_apart
from tests.benchmarks.metric import Skipped

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mapped:
    """Result of some pictures."""

    seconds: float
    c_T_w: dict[str, Array]
    """Poses (3, 4) by file name, of the pictures in the largest model, whose scale is arbitrary."""
    models: int


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
    return Mapped(found["seconds"], poses, found["models"])


def mapped(
    pictures: Path,
    names: list[str],
    side_px: int | None = None,
    camera: tuple[float, ...] | None = None,
    free_center: bool = False,
) -> Mapped:
    """Map some pictures of a folder, reduced to ``side_px``; without ``camera`` its lens is estimated.

    With ``free_center`` the lens is OpenCV's, and its principal point is estimated too.

    Raises ``Skipped`` where the package is missing.
    """
    colmap = _package()
    colmap.logging.minloglevel = 2
    reader, mapping = colmap.ImageReaderOptions(), colmap.IncrementalPipelineOptions()
    extraction, cpu = colmap.FeatureExtractionOptions(), colmap.Device.cpu
    if side_px is not None:
        extraction.max_image_size = side_px
    if camera is not None:
        # Its pixel (0, 0) is the corner of the first.
        fx, fy, cx, cy, *distortion = camera
        reader.camera_model = "OPENCV"
        reader.camera_params = ",".join(map(str, (fx, fy, cx + 0.5, cy + 0.5, *distortion)))
        mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = False
        mapping.mapper.abs_pose_refine_focal_length = mapping.mapper.abs_pose_refine_extra_params = False
    if free_center:
        reader.camera_model, mapping.ba_refine_principal_point = "OPENCV", True
    with tempfile.TemporaryDirectory() as scratch:
        database = Path(scratch) / "pictures.db"
        began = time.perf_counter()
        colmap.extract_features(
            database, pictures, names, colmap.CameraMode.SINGLE, reader, extraction, device=cpu
        )
        colmap.match_exhaustive(database, device=cpu)
        models = colmap.incremental_mapping(database, pictures, Path(scratch), mapping)
        seconds = time.perf_counter() - began
    if not models:
        return Mapped(seconds, {}, 0)
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    poses = {
        image.name: image.cam_from_world().matrix() for image in largest.images.values() if image.has_pose
    }
    return Mapped(seconds, poses, len(models))


def _package() -> Any:
    try:
        import pycolmap
    except ImportError:
        raise Skipped("pycolmap is not installed (pip install --group bench)") from None
    return pycolmap


def main(pictures: Path, camera: str) -> None:
    """Run the separate process."""
    names = sorted(path.name for path in pictures.iterdir())
    done = mapped(pictures, names, camera=tuple(map(float, camera.split(","))))
    poses = {name: pose.tolist() for name, pose in done.c_T_w.items()}
    print(json.dumps({"seconds": done.seconds, "c_T_w": poses, "models": done.models}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
