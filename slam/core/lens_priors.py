"""How well the numbers of a lens are known where only nominal values are."""

from __future__ import annotations

from dataclasses import replace

from frontend.camera import Camera

UNKNOWN_FOCAL_STD_RATIO = 0.3
"""Relative standard deviation of a focal length of which nothing is told. That of a 28 mm lens on 35 mm film
is assumed, while the lenses of drones have 20 mm (Parrot, small ones of DJI) to 50 mm (survey cameras)."""
ASSUMED_FOCAL_STD_RATIO = 0.1
"""Relative standard deviation of a focal length that is told and perhaps wrong."""
PLAUSIBLE_FOCAL = (0.3, 30.0)
"""Limits of the focal length over the longer side: 118 to 2 degrees of view."""
NOMINAL_FOCAL_STD_RATIO = 0.03
"""Relative standard deviation of a focal length that is the nominal one of a model (Exif)."""
CENTER_STD_RATIO = 0.01
"""Standard deviation of the principal point over the longer side. Makers' calibrations are off by as much as
that of pictures without one: focus, temperature and a new lens shift it."""
NOMINAL_RADIAL_STD = 0.1
"""Standard deviation of the radial numbers of a lens without a calibration."""
TANGENTIAL_STD = 0.002
"""Standard deviation of p1 and p2: their usual size, since makers' values are not better than none."""


def as_nominal(camera: Camera) -> Camera:
    """Return a camera whose lens is known no better than by nominal values."""
    return replace(
        camera,
        focal_std_ratio=max(camera.focal_std_ratio, NOMINAL_FOCAL_STD_RATIO),
        center_std_px=max(camera.center_std_px, CENTER_STD_RATIO * max(camera.size_px)),
        radial_std=max(camera.radial_std, NOMINAL_RADIAL_STD),
        tangential_std=max(camera.tangential_std, TANGENTIAL_STD),
    )


def as_assumed(camera: Camera) -> Camera:
    """Return a camera whose lens is known no better than by a focal length that is perhaps wrong."""
    nominal = as_nominal(camera)
    return replace(nominal, focal_std_ratio=max(nominal.focal_std_ratio, ASSUMED_FOCAL_STD_RATIO))
