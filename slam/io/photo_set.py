"""Selection of the photographs of a flight: readable, of one camera, and looking down."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.progress import Progress
from slam.io.exif import Angles, PhotoTags, read_tags
from slam.io.files import refusal
from slam.io.gimbal import body_from_gimbal, body_from_mount, tilt_deg

Array = NDArray[np.float64]

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff"})
MAX_TILT_DEG = 30.0
"""Largest angle between the optical axis and straight down. Photographs with a larger angle are left out."""

_MAX_LISTED = 5


@dataclass(frozen=True)
class Photo:
    """One photograph of a set."""

    name: str
    path: Path
    tags: PhotoTags
    w_R_b: Array | None = None
    """(3, 3) attitude of the body at the exposure; None if the tags do not contain it."""


@dataclass(frozen=True)
class AttitudeSource:
    """Kind of attitude angles with its accuracy."""

    description: str
    angles: Callable[[PhotoTags], Angles | None]
    w_R_b: Callable[[float, float, float], Array]
    """Conversion from yaw, pitch, roll in degrees to the attitude (3, 3)."""
    std_deg: Angles
    """Standard deviations of roll, pitch, yaw."""


@dataclass(frozen=True)
class PhotoSet:
    """Photographs to use, in the natural order of their names."""

    photos: tuple[Photo, ...]
    attitude: AttitudeSource | None
    remarks: tuple[str, ...]
    """One line for each photograph left out and each assumption."""


def holds_photos(folder: Path) -> bool:
    """Return whether a folder or its subfolders contain a file with the suffix of a photograph."""
    try:
        return any(_is_photo(path) for path in folder.rglob("*"))
    except OSError as error:
        raise refusal(folder, f"cannot be read ({error.strerror})", "check its permissions") from None


def select_photos(folder: Path, progress: Progress) -> PhotoSet:
    """Return the usable photographs of a folder.

    Raises ``InputError`` if there is no folder, no photograph in it, or no usable one.
    """
    found, remarks = _find(folder)
    left_out: dict[str, list[str]] = defaultdict(list)
    photos = _read(found, left_out, progress)
    source = next((s for s in _SOURCES if any(any(s.angles(p.tags) or ()) for p in photos)), None)
    photos = _down_looking([_with_attitude(photo, source) for photo in photos], left_out)
    photos = _of_one_camera(photos, left_out)
    lines = tuple(
        f"{len(names)} of {len(found)} photographs left out: {reason} ({listed(names)})"
        for reason, names in sorted(left_out.items())
    )
    if not photos:
        raise refusal(
            folder, f"no photograph in it can be used: {'; '.join(lines)}", "repair or replace them"
        )
    without = sum(photo.w_R_b is None for photo in photos)
    if source is None or without == len(photos):
        attitude = "no attitude recorded: straight down assumed"
    else:
        attitude = f"attitude from {source.description}, good to {max(source.std_deg):g} degrees assumed"
        attitude += f"; {without} photographs without it" if without else ""
    return PhotoSet(tuple(photos), source, (*remarks, *lines, attitude))


def _find(folder: Path) -> tuple[list[tuple[str, Path]], tuple[str, ...]]:
    """Return name and path of each photograph in natural order, and remarks about the search."""
    if not folder.exists():
        raise refusal(folder, "no such folder", "give the folder that holds the photographs")
    if not folder.is_dir():
        raise refusal(folder, "a file, not a folder of photographs", "unpack it if it is an archive")
    try:
        here = [path for path in folder.iterdir() if _is_photo(path)]
        in_subfolders = [] if here else [path for path in folder.rglob("*") if _is_photo(path)]
    except OSError as error:
        raise refusal(folder, f"cannot be read ({error.strerror})", "check its permissions") from None
    if not here and not in_subfolders:
        kinds = ", ".join(sorted(SUFFIXES))
        raise refusal(folder, "no photographs in it", f"give a folder that holds {kinds} files")
    paths = sorted(here or in_subfolders, key=lambda path: _natural(str(path.relative_to(folder))))
    same = Counter(path.name for path in paths)
    named = [(p.name if same[p.name] == 1 else "_".join(p.relative_to(folder).parts), p) for p in paths]
    remark = f"no photographs in the folder itself: the {len(in_subfolders)} in its subfolders are used"
    return named, (remark,) if in_subfolders else ()


def _is_photo(path: Path) -> bool:
    return path.suffix.casefold() in SUFFIXES and not path.name.startswith(".") and not path.is_dir()


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a sort key that places IMG_9 before IMG_10."""
    return [(int(part) if part.isdecimal() else -1, part.casefold()) for part in re.split(r"(\d+)", name)]


def _read(
    found: Sequence[tuple[str, Path]], left_out: dict[str, list[str]], progress: Progress
) -> list[Photo]:
    photos = []
    for k, (name, path) in enumerate(found):
        progress("tags", k, len(found))
        try:
            if not name.isprintable():
                name = name.encode("unicode_escape").decode()
                raise InputError("a control character in the file's name")
            if not path.is_file():
                raise InputError("not a regular file")
            photos.append(Photo(name, path, read_tags(path)))
        except InputError as error:
            left_out[str(error)].append(name)
    progress("tags", len(found), len(found))
    return photos


def _body_from_camera_tags(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Array:
    # Some writers of Pix4D's names store the gimbal's pitch; no mapping camera looks straight back.
    body = body_from_gimbal if pitch_deg < -60 else body_from_mount
    return body(yaw_deg, pitch_deg, roll_deg)


_SOURCES = (
    AttitudeSource("the gimbal's angles", lambda tags: tags.gimbal, body_from_gimbal, (2, 2, 5)),
    AttitudeSource("the camera's angles", lambda tags: tags.mount, _body_from_camera_tags, (2, 2, 5)),
    AttitudeSource(
        "the airframe's angles with a fixed camera", lambda tags: tags.airframe, body_from_mount, (5, 5, 10)
    ),
)
"""Sources in the order of their accuracy. A kind that is zero in every photograph was not recorded."""


def _with_attitude(photo: Photo, source: AttitudeSource | None) -> Photo:
    angles = source.angles(photo.tags) if source is not None else None
    return photo if source is None or angles is None else replace(photo, w_R_b=source.w_R_b(*angles))


def _down_looking(photos: Sequence[Photo], left_out: dict[str, list[str]]) -> list[Photo]:
    """Return the photographs that look down or have no attitude."""
    down = []
    for photo in photos:
        if photo.w_R_b is not None and tilt_deg(photo.w_R_b) > MAX_TILT_DEG:
            reason = f"looks more than {MAX_TILT_DEG:g} degrees away from straight down"
            left_out[reason].append(photo.name)
        else:
            down.append(photo)
    return down


def _of_one_camera(photos: Sequence[Photo], left_out: dict[str, list[str]]) -> list[Photo]:
    """Return the largest group with one model, size and focal length; of equal groups the first by name."""
    kinds = [((p.tags.make, p.tags.model), p.tags.size_px, p.tags.focal_mm) for p in photos]
    most = Counter(kinds).most_common(1)
    kept = []
    for photo, kind in zip(photos, kinds, strict=True):
        (_, model), size, focal_mm = most[0][0]
        if kind == most[0][0]:
            kept.append(photo)
        elif kind[1] != size:
            left_out[f"another size than the {size[0]} x {size[1]} px of most"].append(photo.name)
        elif kind[0] != most[0][0][0]:
            left_out[f"another camera than the {model or 'nameless one'} of most"].append(photo.name)
        else:
            left_out[f"another focal length than the {focal_mm or '(unknown)'} mm of most"].append(photo.name)
    return kept


def listed(names: Sequence[str]) -> str:
    """Return the first names and the number of the others."""
    more = len(names) - _MAX_LISTED
    return ", ".join(names[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
