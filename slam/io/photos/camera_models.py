"""Lenses of ``camera_models.json`` (OpenSfM) and ``cameras.json`` (OpenDroneMap) beside photographs.

Both hold calibrated cameras under names such as ``v2 dji fc6310r 5472 3648 brown 0.6666``. Lengths are over
the longer side of a picture, from its middle, so that they hold for each size. Source: OpenSfM's
documentation, "Geometric models" and "camera_models.json".
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from slam.core.errors import InputError
from slam.core.messages import Message, note, warning
from slam.io.files import brief, read_text, refused_file, shown
from slam.io.photos.camera import stored_over_original
from slam.io.photos.exif import PhotoTags
from slam.io.photos.lens_tags import LensTags
from slam.io.photos.photo_set import Photo

NAMES = ("camera_models_overrides.json", "camera_models.json", "cameras.json")
"""The first file with the lens counts: OpenSfM takes the overrides, which a person writes, before its own."""
_MAX_BYTES = 1 << 22
_RADIAL = {
    "perspective": ("k1", "k2"),
    "simple_radial": ("k1",),
    "radial": ("k1", "k2"),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
}
"""Projection -> its numbers, with OpenCV's names and meaning."""
_FISHEYE = {"fisheye": ("k1", "k2"), "fisheye_opencv": ("k1", "k2", "k3", "k4")}
"""Projections in which the radius is the angle with k1, k2... at its powers 3, 5..."""
_SAME_SHAPE = 0.01
"""Relative difference of the ratio of the sides of a picture and of a copy in whole pixels."""
_NO_MODEL = "unknown"


def with_camera_models(
    photos: Sequence[Photo], folder: Path, beside: Sequence[Path]
) -> tuple[list[Photo], list[Path], tuple[Message, ...]]:
    """Return photographs with the lens of a file, the other files ``beside`` them, and lines about it.

    A calibration of the maker in the tags is preferred.
    """
    photos, remarks, source = list(photos), list[Message](), "the tags have"
    files = [path for path in beside if path.name in NAMES]
    for path in sorted(files, key=lambda path: NAMES.index(path.name)):
        name = shown(str(path.relative_to(folder)))
        try:
            cameras = _cameras(path, folder)
        except InputError as refused:
            remarks.append(refused_file(refused, folder, "its lenses are not used"))
            continue
        if all(_has_calibration(photo) for photo in photos):
            remarks.append(note(f"{name} is not used: {source} a calibration of the lens"))
            continue
        tags = photos[0].tags
        lens = next((lens for key, camera in cameras if (lens := _lens(key, camera, tags, name))), None)
        if lens is None:
            keys = brief(", ".join(key for key, _ in cameras), 120)
            remarks.append(
                warning(
                    f"{name} has no calibrated lens of the {tags.model or 'camera'} with pictures of "
                    f"{tags.size_px[0]} x {tags.size_px[1]} px ({keys}): it is not used"
                )
            )
            continue
        source = f"{name} has"
        photos = [
            photo if _has_calibration(photo) else replace(photo, tags=replace(photo.tags, lens=lens))
            for photo in photos
        ]
    return photos, [path for path in beside if path.name not in NAMES], tuple(remarks)


def _has_calibration(photo: Photo) -> bool:
    return photo.tags.lens is not None or photo.tags.dewarp is not None


def _cameras(path: Path, folder: Path) -> list[tuple[str, dict[str, Any]]]:
    try:
        content = json.loads(read_text(path, folder, _MAX_BYTES)[0])
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or not all(isinstance(each, dict) for each in content.values()):
        raise InputError(f"{path}: holds no cameras of OpenSfM or OpenDroneMap")
    return list(content.items())


def _lens(key: str, camera: dict[str, Any], tags: PhotoTags, file: str) -> LensTags | None:
    """Return the lens of a camera for photographs; None for another camera, and without a calibration."""
    kind = str(camera.get("projection_type", "")).lower()
    names = _RADIAL.get(kind) or _FISHEYE.get(kind)
    width, height = _number(camera, "width"), _number(camera, "height")
    focal = [_number(camera, name, _number(camera, "focal")) for name in ("focal_x", "focal_y")]
    center = [_number(camera, name, 0.0) for name in ("c_x", "c_y")]
    numbers = [_number(camera, name, 0.0) for name in names or ()]
    known = all(map(math.isfinite, (width, height, *focal, *center, *numbers)))
    if names is None or not known or min(width, height, *focal) <= 0 or not any(numbers):
        return None
    ratio = (width / height) / (tags.size_px[0] / tags.size_px[1])
    if abs(ratio - 1) > _SAME_SHAPE or not _is_of(key.lower(), tags):
        return None
    per_side = max(tags.size_px) / stored_over_original(tags)
    size_px = [side / stored_over_original(tags) for side in tags.size_px]
    fx, fy = (f * per_side for f in focal)
    u, v = (side / 2 + c * per_side for side, c in zip(size_px, center, strict=True))
    source = f"in {file} ({brief(key, 80)})"
    if kind in _FISHEYE:
        # An angle, and its powers 3, 5...; the even ones are absent.
        odd = [coefficient for k in (1.0, *numbers) for coefficient in (0.0, k)]
        return LensTags((fx, fy), (u, v), polynomial=tuple(odd), source=source)
    of = dict(zip(names, numbers, strict=True))
    distortion = tuple(of.get(name, 0.0) for name in _RADIAL["brown"])
    return LensTags((fx, fy), (u, v), distortion=distortion, source=source)


def _is_of(key: str, tags: PhotoTags) -> bool:
    """Return whether a camera has the name of the photographs' one; a nameless one may be any."""
    model = tags.model.lower()
    return not model or model in key or key.startswith((f"v2 {_NO_MODEL} ", f"{_NO_MODEL} "))


def _number(camera: dict[str, Any], name: str, default: float = math.nan) -> float:
    value = camera.get(name, default)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
