"""The lens that a map has estimated, beside the stated one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from backend.bundle.lens import NAMES, prior_calibration
from backend.bundle.refinement import Bundle
from frontend.camera import Camera
from slam.core.instrument_errors import LensNumber


def lens_numbers(bundle: Bundle | None) -> Mapping[str, LensNumber] | None:
    """Return each number of the calibration by its name; None if the calibration was fixed."""
    if bundle is None or bundle.lens is None:
        return None
    lens, prior = bundle.lens, prior_calibration(bundle.optimum.problem.camera)
    rows = zip(
        lens.calibration.tolist(), lens.std.tolist(), prior.tolist(), lens.prior_std.tolist(),
        lens.is_estimated.tolist(), strict=True,
    )  # fmt: skip
    return {name: LensNumber(*row) for name, row in zip(NAMES[lens.model], rows, strict=True)}


def calibrated(camera: Camera, bundle: Bundle | None) -> Camera:
    """Return the camera with the mount and the lens that a refinement has estimated, if there is one."""
    camera = replace(camera, stated=None)
    if bundle is None:
        return camera
    camera = replace(camera, b_T_c=bundle.b_T_c)
    if bundle.lens is None:
        return camera
    fx, fy, cx, cy, *distortion = bundle.lens.calibration.tolist()
    return replace(
        camera,
        focal_px=(fx, fy),
        center_px=(cx, cy),
        distortion=tuple(distortion),
        lens=bundle.lens.model,
    )
