"""Calibration of a lens from Pix4D's tags, as Parrot's Sequoia and MicaSense's cameras write them.

Source: Pix4D, "Specifications of xmp.camera tags" and "How are the internal camera parameters defined".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from slam.io.lens_fit import LensFit, fisheye_angles, fitted_fisheye
from slam.io.photos.tag_values import numbers
from slam.io.photos.xmp import Xmp

Array = NDArray[np.float64]

_MAX_DISTORTION = 100.0


@dataclass(frozen=True)
class LensTags:
    """Calibration of a lens, in pixels of the original size."""

    focal_px: tuple[float, float]
    center_px: tuple[float, float] | None
    """Position of the principal point from the outer corner of the first pixel; None if it is unknown."""
    distortion: tuple[float, ...] = ()
    """OpenCV's k1, k2, p1, p2, k3; empty for a fisheye lens."""
    polynomial: tuple[float, ...] = ()
    """Coefficients of a fisheye lens: radius in ``focal_px`` by powers of the angle from the axis [rad]."""
    source: str = "in the tags"
    """Place of the calibration, in words."""


def read_lens(xmp: Xmp, px_per_mm: float | None) -> LensTags | None:
    """Return the calibration in the tags of a sensor with ``px_per_mm``; None if a part is missing."""
    principal_mm = _numbers(xmp.text("camera", "PrincipalPoint"), 2)
    center_px = None
    if principal_mm is not None and px_per_mm is not None:
        center_px = principal_mm[0] * px_per_mm, principal_mm[1] * px_per_mm
    if xmp.text("camera", "ModelType").casefold() == "fisheye":
        return _fisheye(xmp, center_px)
    focal = _numbers(xmp.text("camera", "PerspectiveFocalLength"), 1)
    radtan = _numbers(xmp.text("camera", "PerspectiveDistortion"), 5)
    in_pixels = xmp.text("camera", "PerspectiveFocalLengthUnits").casefold() in ("px", "pixel", "pixels")
    scale = 1.0 if in_pixels else px_per_mm
    if focal is None or radtan is None or scale is None or focal[0] <= 0:
        return None
    if max(map(abs, radtan)) > _MAX_DISTORTION:
        return None
    k1, k2, k3, p1, p2 = radtan
    return LensTags((focal[0] * scale, focal[0] * scale), center_px, (k1, k2, p1, p2, k3))


def _fisheye(xmp: Xmp, center_px: tuple[float, float] | None) -> LensTags | None:
    """Return a fisheye lens.

    Pix4D's radius is a polynomial of the angle as a share of a right angle, and its affine matrix C, D, E, F
    is in pixels. C and F are the scales; the shear D, E of a real lens is zero.
    """
    polynomial = _numbers(xmp.text("camera", "FisheyePolynomial"), 4)
    affine = _numbers(xmp.text("camera", "FisheyeAffineMatrix"), 4)
    if polynomial is None or affine is None or polynomial[1] <= 0 or min(affine[0], affine[3]) <= 0:
        return None
    if max(map(abs, polynomial)) > _MAX_DISTORTION:
        return None
    share_per_rad = 2 / np.pi
    focal_px = affine[0] * polynomial[1] * share_per_rad, affine[3] * polynomial[1] * share_per_rad
    by_angle = np.array(polynomial) * share_per_rad ** np.arange(4) / (polynomial[1] * share_per_rad)
    return LensTags(focal_px, center_px, polynomial=tuple(by_angle.tolist()))


def fitted_lens(lens: LensTags, radius_px: float) -> LensFit | None:
    """Return OpenCV's fisheye for the polynomial of a lens, up to ``radius_px`` from the principal point.

    OpenCV has odd powers of the angle alone, Pix4D all, so the fit has an error. Lengths refer to
    the original size. The result is None if the view is too wide.
    """
    angle, focal_px = fisheye_angles(), float(np.mean(lens.focal_px))
    return fitted_fisheye(angle, np.asarray(polyval(angle, lens.polynomial)), radius_px / focal_px)


def _numbers(text: str, count: int) -> tuple[float, ...] | None:
    """Return the first ``count`` numbers of a list such as "1.5,527/100"; None if one is not finite."""
    found = numbers(text.split(",")[:count], count)
    return None if found is None else tuple(found.tolist())
