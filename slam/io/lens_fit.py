"""Description of a lens by a model that a camera has: a pinhole with radial distortion, or a fisheye."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MAX_ANGLE = 0.8
"""Largest angle from the axis, as a share of a right angle, for a pinhole with radial distortion."""
_MAX_FISHEYE_ANGLE = 80 / 90
"""The same for a fisheye: `frontend.camera` undistorts its pixels up to it."""
_SAMPLES = 4000


@dataclass(frozen=True)
class LensFit:
    """A lens of a known model that is close to one of another model."""

    ratio: float
    """Factor on the focal length of the other model."""
    distortion: tuple[float, ...]
    """OpenCV's k1, k2, p1, p2, k3; of a fisheye k1, k2, k3, k4."""
    error: float
    """Largest error as a share of the focal length of the other model."""


def viewing_angles() -> Array:
    """Return angles (n,) from the axis in radians at which a lens is evaluated for ``fitted_radial``."""
    return np.linspace(0, _MAX_ANGLE * np.pi / 2, _SAMPLES)[1:]


def fisheye_angles() -> Array:
    """Return angles (n,) from the axis in radians at which a lens is evaluated for ``fitted_fisheye``."""
    return np.linspace(0, _MAX_FISHEYE_ANGLE * np.pi / 2, _SAMPLES)[1:]


def fitted_radial(angle_rad: Array, recorded: Array, radius: float) -> LensFit | None:
    """Return the pinhole camera whose picture is that of another lens up to ``radius``.

    ``recorded`` (n,) are the distances from the principal point at ``angle_rad`` (n,), and ``radius`` is that
    of the farthest corner, all as shares of the focal length. The result is None if the view is too wide.
    """
    found = _fitted(np.tan(angle_rad), recorded, radius, 4)
    if found is None:
        return None
    ratio, (k1, k2, k3), error = found
    return LensFit(ratio, (k1, k2, 0.0, 0.0, k3), error)


def fitted_fisheye(angle_rad: Array, recorded: Array, radius: float) -> LensFit | None:
    """Return OpenCV's fisheye whose picture is that of another lens, as ``fitted_radial`` does a pinhole."""
    found = _fitted(angle_rad, recorded, radius, 5)
    return None if found is None else LensFit(found[0], tuple(found[1]), found[2])


def within_view(recorded: Array, radius: float) -> bool:
    """Return whether the distances (n,) of increasing angles increase, and reach ``radius``."""
    within = recorded < radius
    return not (within.all() or (np.diff(recorded) <= 0)[within[1:]].any())


def _fitted(
    base: Array, recorded: Array, radius: float, terms: int
) -> tuple[float, list[float], float] | None:
    """Return the factor on the focal length, coefficients of odd powers over it, and the largest error."""
    if not within_view(recorded, radius):
        return None
    inside = slice(int(np.argmin(recorded < radius)) + 1)
    powers = base[inside, None] ** np.arange(1, 2 * terms, 2)
    (ratio, *k), *_ = np.linalg.lstsq(powers, recorded[inside], rcond=None)
    error = float(np.abs(powers @ [ratio, *k] - recorded[inside]).max())
    return float(ratio), [float(value / ratio) for value in k], error
