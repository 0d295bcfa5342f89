"""The lens of a ``CameraInfo`` in OpenCV's radial and tangential distortion, or in its fisheye.

Models and their names are those of ROS: ``plumb_bob``, ``rational_polynomial``, and ``equidistant`` (also
``fisheye``; OpenCV's fisheye model, Kannala and Brandt, PAMI 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from backend.measurements import LensModel
from slam.core.messages import Message, note, warning
from slam.io.camera_folder import EQUIDISTANT
from slam.io.lens_fit import fisheye_angles, fitted_radial, viewing_angles, within_view

Array = NDArray[np.float64]
RosMessage = Any

_RADTAN = ("plumb_bob", "rational_polynomial", "")
_ASPECT_TOLERANCE_PX = 1.0
"""Sizes of one picture in two resolutions differ by rounding."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics in the pixels of the pictures."""

    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    """OpenCV's k1, k2, p1, p2[, k3], or k1, k2, k3, k4 of its fisheye."""
    model: LensModel = "brown"


class UnknownLensError(Exception):
    """A ``CameraInfo`` that describes no lens; the message is the reason and the next step."""


def lens_of(
    info: RosMessage, size_px: tuple[int, int], rectified: bool = False
) -> tuple[Lens, list[Message]]:
    """Return the lens for pictures of ``size_px``, and a line for everything that is assumed.

    That of ``rectified`` pictures is ``P``, without distortion. Raises ``UnknownLensError``.
    """
    projection = np.asarray(getattr(info, "p", getattr(info, "P", np.zeros(12))), float)
    if rectified and projection.size == 12 and projection[0] > 0 and projection[5] > 0:
        (fx, fy, cx, cy), notes = _in_picture(info, projection.reshape(3, 4), size_px)
        return Lens((fx, fy), (cx, cy)), [
            *notes,
            note("rectified pictures, by the name of their topic: focal length of P, no lens distortion"),
        ]
    matrix = np.asarray(getattr(info, "k", getattr(info, "K", np.zeros(9))), float).reshape(3, 3)
    coefficients = np.asarray(getattr(info, "d", getattr(info, "D", ())), float)
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise UnknownLensError("CameraInfo is not calibrated (its focal length is 0)")
    (fx, fy, cx, cy), notes = _in_picture(info, matrix, size_px)
    model = str(info.distortion_model).lower()
    if model in _RADTAN and not np.any(coefficients[5:]):
        kept = [*coefficients[:5], 0.0, 0.0, 0.0, 0.0][: 5 if len(coefficients) >= 5 else 4]
        return Lens((fx, fy), (cx, cy), tuple(float(v) for v in kept)), notes
    corners = np.array([[u, v] for u in (0, size_px[0] - 1) for v in (0, size_px[1] - 1)], float)
    radius = float(np.linalg.norm((corners - (cx, cy)) / (fx, fy), axis=1).max())
    if model in EQUIDISTANT and len(coefficients) >= 4:
        angle = fisheye_angles()
        if not within_view(angle * polyval(angle**2, [1.0, *coefficients[:4]]), radius):
            raise UnknownLensError(_too_wide(model))
        k1, k2, k3, k4 = (float(v) for v in coefficients[:4])
        return Lens((fx, fy), (cx, cy), (k1, k2, k3, k4), "equidistant"), notes
    if model not in _RADTAN or len(coefficients) < 8 or np.any(coefficients[8:]):
        raise UnknownLensError(
            f"the lens model {model[:40]!r} with {len(coefficients)} coefficients is not known; undistort "
            "the pictures first (image_proc)"
        )
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients[:8]
    angle = viewing_angles()
    squared = np.tan(angle) ** 2
    quotient = polyval(squared, [1.0, k1, k2, k3]) / polyval(squared, [1.0, k4, k5, k6])
    found = fitted_radial(angle, np.tan(angle) * quotient, radius)
    if found is None:
        raise UnknownLensError(_too_wide(model))
    k1, k2, _, _, k3 = found.distortion
    p1, p2 = float(p1) / found.ratio, float(p2) / found.ratio
    notes.append(
        warning(
            f"its {model} lens is described by radial distortion, with errors of up to "
            f"{found.error * fx:.2f} px"
        )
    )
    return Lens((fx * found.ratio, fy * found.ratio), (cx, cy), (k1, k2, p1, p2, k3)), notes


def _too_wide(model: str) -> str:
    """Return why a view is refused, and the next step."""
    return (
        f"the view of its {model} lens is too wide or folds back; undistort the pictures first (image_proc)"
    )


def _in_picture(
    info: RosMessage, matrix: Array, size_px: tuple[int, int]
) -> tuple[tuple[float, float, float, float], list[Message]]:
    """Return fx, fy, cx, cy in the pixels of the pictures, and a note where they are of another resolution.

    ``K`` refers to the full resolution; a region of interest and binning reduce the pictures
    (``sensor_msgs/CameraInfo``).
    """
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    full = int(info.width), int(info.height)
    if size_px == full or not all(full):
        return (fx, fy, cx, cy), []
    roi = getattr(info, "roi", None)
    bins = max(int(getattr(info, "binning_x", 1)), 1), max(int(getattr(info, "binning_y", 1)), 1)
    left, top = (0, 0) if roi is None else (int(roi.x_offset), int(roi.y_offset))
    inside = full if roi is None or not roi.width else (int(roi.width), int(roi.height))
    if size_px == (inside[0] // bins[0], inside[1] // bins[1]):
        sx, sy = 1 / bins[0], 1 / bins[1]
        said = "CameraInfo states a region of interest or binning, which is applied"
    elif abs(size_px[0] * full[1] / full[0] - size_px[1]) <= _ASPECT_TOLERANCE_PX:
        left, top = 0, 0
        sx, sy = size_px[0] / full[0], size_px[1] / full[1]
        said = f"CameraInfo is for {full[0]} x {full[1]} px and is scaled to {size_px[0]} x {size_px[1]}"
    else:
        raise UnknownLensError(
            f"the pictures have {size_px[0]} x {size_px[1]} px, but CameraInfo is for {full[0]} x {full[1]}; "
            "calibrate the camera in this mode"
        )
    # The first pixel's centre is 0, so its outer corner is -0.5.
    return (fx * sx, fy * sy, (cx - left + 0.5) * sx - 0.5, (cy - top + 0.5) * sy - 0.5), [warning(said)]
