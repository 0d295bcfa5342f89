"""Camera of a set of photographs, from their tags about lens and sensor.

The sources in the order of their accuracy are the maker's calibration (``DewarpData``, the lens tags of
Pix4D), a file beside the photographs (`slam.io.photos.camera_models`), ``CalibratedFocalLength``, the focal
length with the sensor's resolution, that on 35 mm film by the tags, or by the specification of the model, and
an assumed field of view. Photographs are often scaled down after the flight without a change of
these tags, so pixel counts refer to the original size. An orientation tag turns the view but not the
intrinsics, which belong to the stored pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frontend.camera import Camera
from slam.core.lens_priors import (
    CENTER_STD_RATIO,
    NOMINAL_FOCAL_STD_RATIO,
    NOMINAL_RADIAL_STD,
    PLAUSIBLE_FOCAL,
    TANGENTIAL_STD,
    UNKNOWN_FOCAL_STD_RATIO,
)
from slam.core.messages import Message, warning
from slam.io.photos.exif import PhotoTags
from slam.io.photos.lens_tags import fitted_lens
from slam.io.recordings.video.model_lens import film_focal

_ASSUMED_VIEW_DEG = 65.0
"""Assumed field of view along the longer side without tags: that of a 28 mm lens on 35 mm film."""
ASSUMED_VIEW = f"a view of {_ASSUMED_VIEW_DEG:g} degrees along the longer side"

_UNDISTORT = "undistort the pictures"
"""Advice where a lens is too wide for the camera model."""
_FILM_DIAGONAL_MM = float(np.hypot(36, 24))
_SOURCES = ("dewarp", "lens", "calibrated", "tags", "model", "assumed")
"""Sources of a focal length, the best first. All but the assumed one are told as nominal: no tag is the
calibration of its user, as focus and temperature are not those of the factory. The two that one maker tells
of one lens differ by 2.7 % (DewarpData and CalibratedFocalLength of a Phantom 4 Multispectral), and which is
nearer no tag tells."""
_ASPECT_STD_RATIO = 0.005
"""Relative standard deviation of either focal length of ``DewarpData`` about both. Pixels are square, but
these differ by 0.9 % (Phantom 4 Multispectral)."""
_LEAST_SENSOR_MM = 2.4
"""Width of the smallest sensors of cameras (1/6 inch). An editor that writes the new size, but leaves the
resolution of the sensor, makes the sensor smaller."""
_MAX_FOCAL_RATIO = 1.15
"""Largest ratio of the two Exif focal lengths. Rounding to a millimetre and crops lead to smaller ones."""


@dataclass(frozen=True)
class _Focal:
    px: float
    source: str
    remark: tuple[str, ...]


def photo_camera(photos: Sequence[PhotoTags]) -> tuple[Camera, tuple[Message, ...]]:
    """Return the camera of all ``photos`` (one model, one size), and the assumptions, one line each."""
    # The median limits the effect of a single damaged tag.
    focals = [_focal(tags) for tags in photos]
    best = min(_SOURCES, key=lambda source: -sum(f.source == source for f in focals))
    of_best_source = [f for f in focals if f.source == best]
    median = of_best_source[int(np.argsort([f.px for f in of_best_source])[len(of_best_source) // 2])]
    tags = photos[focals.index(median)]
    width, height = tags.size_px
    camera = Camera(
        focal_px=(median.px, median.px),
        center_px=((width - 1) / 2, (height - 1) / 2),
        size_px=tags.size_px,
        focal_std_ratio=UNKNOWN_FOCAL_STD_RATIO if best == "assumed" else NOMINAL_FOCAL_STD_RATIO,
        center_std_px=CENTER_STD_RATIO * max(width, height),
        radial_std=0.02 if best in ("dewarp", "lens") else NOMINAL_RADIAL_STD,
        tangential_std=TANGENTIAL_STD,
    )
    distortion: tuple[str, ...] = ("no lens distortion assumed, the map estimates it",)
    if best == "dewarp":
        camera, distortion = _dewarped(camera, tags), ()
    elif best == "lens":
        camera, distortion = _with_lens(camera, tags)
    first, *others = median.remark
    said = warning(f"focal length {median.px:.1f} px {first}", *others, *distortion)
    return camera, (said if median.source == "assumed" or _UNDISTORT in distortion else said.as_note(),)


def _focal(tags: PhotoTags) -> _Focal:
    width, height = tags.size_px
    scale, scaled = _scale(tags)
    candidates: list[_Focal] = []
    if tags.dewarp is not None and abs(tags.dewarp[4]) < 2:
        fx, fy = tags.dewarp[:2]
        if 0.9 < fx / max(fy, 1e-9) < 1.1:
            candidates.append(
                _Focal(fx * scale, "dewarp", (f"from the maker's calibration in the tags{scaled}",))
            )
    if tags.lens is not None:
        px = tags.lens.focal_px[0] * scale
        candidates.append(
            _Focal(px, "lens", (f"from the calibration of the lens {tags.lens.source}{scaled}",))
        )
    if tags.calibrated_focal_px:
        px = tags.calibrated_focal_px * scale
        candidates.append(_Focal(px, "calibrated", (f"from the maker's CalibratedFocalLength{scaled}",)))
    film = None
    if tags.focal_35mm:
        px = tags.focal_35mm / _FILM_DIAGONAL_MM * float(np.hypot(width, height))
        film = _Focal(px, "tags", (f"from {tags.focal_35mm:g} mm on 35 mm film (Exif)",))
    is_stale = bool(tags.sensor_px_per_mm) and _sensor_mm(tags) < _LEAST_SENSOR_MM
    if tags.focal_mm and tags.sensor_px_per_mm and not is_stale:
        zoom = tags.digital_zoom or 1.0  # of the pixels alone: the lens stays as it is
        px = tags.focal_mm * tags.sensor_px_per_mm * zoom * scale
        zoomed = f", enlarged {zoom:g} times" if zoom != 1 else ""
        by_sensor = f"from {tags.focal_mm:g} mm and {tags.sensor_px_per_mm:.1f} px/mm of sensor (Exif)"
        remark = f"{by_sensor}{zoomed}{scaled}"
        if (
            film is None
            or not _is_plausible(film.px, tags)
            or 1 / _MAX_FOCAL_RATIO < px / film.px < _MAX_FOCAL_RATIO
        ):
            candidates.append(_Focal(px, "tags", (remark,)))
        else:
            # The film value survives any scaling of the picture, the resolution of the sensor does not.
            film = replace(film, remark=(*film.remark, f"the sensor's resolution would give {px:.0f} px"))
    if film is not None:
        candidates.append(film)
    if (of_model := film_focal(tags.model)) is not None:
        film_mm, name = of_model
        px = film_mm / _FILM_DIAGONAL_MM * float(np.hypot(width, height))
        specified = f"from {film_mm:g} mm on 35 mm film by the specification of the {name}"
        candidates.append(_Focal(px, "model", (specified,)))
    none = "no plausible one" if candidates else "none"
    if is_stale:
        none = f"no plausible one (a sensor {_sensor_mm(tags):.1f} mm wide: resized after the flight?)"
    remarks = f"assumed: {ASSUMED_VIEW}", f"the tags give {none}", "copy the originals with their tags"
    fallback = _Focal(assumed_focal_px(tags.size_px), "assumed", remarks)
    return next((c for c in candidates if _is_plausible(c.px, tags)), fallback)


def _sensor_mm(tags: PhotoTags) -> float:
    """Return the width of the sensor by its resolution."""
    return max(*tags.size_px, *(tags.original_size_px or ())) / (tags.sensor_px_per_mm or math.nan)


def assumed_focal_px(size_px: tuple[int, int]) -> float:
    """Return the focal length of the assumed view for pictures of (width, height)."""
    return max(size_px) / 2 / math.tan(math.radians(_ASSUMED_VIEW_DEG / 2))


def relative_focal(tags: PhotoTags) -> float:
    """Return the focal length of one photograph over its longer side, assumed if the tags lack it."""
    return _focal(tags).px / max(tags.size_px)


def _is_plausible(focal_px: float, tags: PhotoTags) -> bool:
    low, high = PLAUSIBLE_FOCAL
    return low < focal_px / max(tags.size_px) < high


def stored_over_original(tags: PhotoTags) -> float:
    """Return the ratio of stored to original pixels of a photograph."""
    return _scale(tags)[0]


def _scale(tags: PhotoTags) -> tuple[float, str]:
    """Return the ratio of stored to original pixels, and its description if they differ."""
    if tags.original_size_px is None:
        return 1.0, ""
    (width, height), (long, short) = tags.size_px, tags.original_size_px
    for across, down in ((long, short), (short, long)):
        ratio = width / across
        if abs(height / down / ratio - 1) < 0.01 and ratio < 0.999:
            return ratio, f", scaled from {across:.0f} to {width} px"
    # The size is equal or cropped, and a crop keeps the pixel size.
    return 1.0, ""


def _dewarped(camera: Camera, tags: PhotoTags) -> Camera:
    """Return the camera with principal point and distortion of ``DewarpData``, in OpenCV's order."""
    assert tags.dewarp is not None
    fx, fy, cx, cy, *distortion = tags.dewarp
    scale, _ = _scale(tags)
    u, v = camera.center_px
    return replace(
        camera,
        focal_px=(fx * scale, fy * scale),
        # The maker states both focal lengths. Of other cameras the pixels are square.
        aspect_std_ratio=_ASPECT_STD_RATIO,
        center_px=(u + cx * scale, v + cy * scale),
        distortion=(0.0, 0.0, 0.0, 0.0) if tags.dewarped else tuple(distortion),
    )


def _with_lens(camera: Camera, tags: PhotoTags) -> tuple[Camera, tuple[str, ...]]:
    """Return the camera with the calibration of ``LensTags``, and clauses about its distortion."""
    assert tags.lens is not None
    lens, (scale, _) = tags.lens, _scale(tags)
    (fx, fy), center_px = lens.focal_px, camera.center_px
    if lens.center_px is not None:
        u, v = (c * scale - 0.5 for c in lens.center_px)
        # A principal point outside the middle half is that of another size.
        if all(0.25 < c / size < 0.75 for c, size in zip((u, v), camera.size_px, strict=True)):
            center_px = u, v
    camera = replace(camera, focal_px=(fx * scale, fy * scale), center_px=center_px)
    if not lens.polynomial:
        return replace(camera, distortion=lens.distortion), ()
    radius_px = float(np.linalg.norm(camera.corners_px - center_px, axis=1).max())
    found = fitted_lens(lens, radius_px / scale)
    if found is None:
        too_wide = "the view of its fisheye is too wide: no distortion assumed"
        return replace(camera, radial_std=NOMINAL_RADIAL_STD), (too_wide, _UNDISTORT)
    error_px = found.error * float(np.mean(lens.focal_px)) * scale
    focal_px = fx * scale * found.ratio, fy * scale * found.ratio
    return (
        replace(camera, focal_px=focal_px, distortion=found.distortion, lens="equidistant"),
        (f"its fisheye is described by OpenCV's fisheye, with errors of up to {error_px:.2g} px",),
    )
