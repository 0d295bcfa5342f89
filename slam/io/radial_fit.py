"""Description of a lens of any model by a pinhole camera with radial distortion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MAX_ANGLE = 0.8
"""Largest angle from the axis, as a share of a right angle, for a pinhole with radial distortion."""
_SAMPLES = 4000


@dataclass(frozen=True)
class RadialFit:
    """A pinhole camera with radial distortion that is close to a lens of another model."""

    ratio: float
    """Factor on the focal length of the other model."""
    distortion: tuple[float, float, float, float, float]
    """OpenCV's k1, k2, p1, p2, k3."""
    error: float
    """Largest error as a share of the focal length of the other model."""


def viewing_angles() -> Array:
    """Return angles (n,) from the axis in radians at which a lens is evaluated for ``fitted_radial``."""
    return np.linspace(0, _MAX_ANGLE * np.pi / 2, _SAMPLES)[1:]


def fitted_radial(angle_rad: Array, recorded: Array, radius: float) -> RadialFit | None:
    """Return the pinhole camera whose picture is that of another lens up to ``radius``.

    ``recorded`` (n,) are the distances from the principal point at ``angle_rad`` (n,), and ``radius`` is that
    of the farthest corner, all as shares of the focal length. The result is None if the view is too wide.
    """
    within = recorded < radius
    if within.all() or (np.diff(recorded) <= 0)[within[1:]].any():
        return None
    inside = slice(int(np.argmin(within)) + 1)
    powers = np.tan(angle_rad[inside])[:, None] ** np.array([1, 3, 5, 7])
    (ratio, *k), *_ = np.linalg.lstsq(powers, recorded[inside], rcond=None)
    error = float(np.abs(powers @ [ratio, *k] - recorded[inside]).max())
    k1, k2, k3 = (float(value / ratio) for value in k)
    return RadialFit(float(ratio), (k1, k2, 0.0, 0.0, k3), error)
