"""Selection of the photographs of a flight: readable, of one camera and band, and showing the ground."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.errors import InputError
from slam.core.messages import Message, note, parsed, warning
from slam.core.names import listed
from slam.core.progress import Progress
from slam.io.down_looking import MAX_TILT_DEG
from slam.io.files import refusal
from slam.io.gimbal import GIMBAL_STD_DEG, body_from_gimbal, body_from_mount, tilt_deg
from slam.io.photos.bands import band_of, chosen_band
from slam.io.photos.camera import relative_focal
from slam.io.photos.copies import REASON, are_copies
from slam.io.photos.exif import Angles, PhotoTags, read_tags
from slam.io.photos.ground_in_view import why_no_ground
from slam.io.photos.position import PhotoPosition
from slam.io.photos.search import find_photos
from slam.io.photos.unused_tags import unused_tags
from slam.io.photos.zoom import zooms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Photo:
    """One photograph of a set."""

    name: str
    path: Path
    tags: PhotoTags
    w_R_b: Array | None = None
    """(3, 3) attitude of the body at the exposure; None if the tags do not contain it."""

    def at(self, position: PhotoPosition) -> Photo:
        """Return the photograph with another position."""
        return replace(self, tags=replace(self.tags, position=position))


@dataclass(frozen=True)
class AttitudeSource:
    """Kind of attitude angles with its accuracy."""

    description: str
    angles: Callable[[PhotoTags], Angles | None]
    w_R_b: Callable[[float, float, float], Array]
    """Conversion from yaw, pitch, roll in degrees to the attitude (3, 3)."""
    std_deg: Angles
    """Standard deviations of roll, pitch, yaw."""

    def at_tilts(self, w_R_b: Sequence[Array]) -> AttitudeSource:
        """Return the source with the noise of attitudes (3, 3) that lean, in the mean of squares.

        A turn about the optical axis is one of the heading straight down. At a tilt t it is a roll times
        tan t and a heading over cos t.
        """
        fall = np.array([R[2, 2] for R in w_R_b])
        level_deg, pitch_deg, yaw_deg = self.std_deg
        roll_deg = level_deg * float(np.sqrt(np.mean(fall**-2 - 1)))
        heading_deg = level_deg * float(np.sqrt(np.mean(fall**-2)))
        return replace(self, std_deg=(max(level_deg, roll_deg), pitch_deg, max(yaw_deg, heading_deg)))


@dataclass(frozen=True)
class PhotoSet:
    """Photographs to use, in the natural order of their names."""

    photos: tuple[Photo, ...]
    attitude: AttitudeSource | None
    remarks: tuple[Message, ...]
    """One line for each reason to leave photographs out, and for each assumption."""
    beside: tuple[Path, ...] = ()
    """Texts in the folder that may tell something about the photographs."""


def select_photos(folder: Path, progress: Progress, band: str | None = None) -> PhotoSet:
    """Return the usable photographs of a folder, of one band of a multispectral camera.

    Raises ``InputError`` if there is no folder, no photograph in it, no usable one, or none of the ``band``.
    """
    found = find_photos(folder)
    left_out: dict[str, list[str]] = defaultdict(list, found.left_out)
    photos = _read(found.photos, left_out, progress)
    photos, band_remarks = _of_one_band(photos, band, left_out)
    source = _attitude_source([photo.tags for photo in photos])
    photos = _of_ground([_with_attitude(photo, source) for photo in photos], left_out)
    photos = _originals(_of_one_camera(photos, left_out), left_out)
    total = len(found.photos) + sum(map(len, found.left_out.values()))
    lines = tuple(
        parsed(f"{len(names)} of {total} photographs left out: {reason} ({listed(names)})")
        for reason, names in sorted(left_out.items())
    )
    if not photos:
        raise refusal(
            folder, f"no photograph in it can be used: {'; '.join(map(str, lines))}", "repair or replace them"
        )
    leaning = [photo.w_R_b for photo in photos if photo.w_R_b is not None]
    without = len(photos) - len(leaning)
    faults = unused_tags(
        "attitude", [(photo.name, photo.tags.attitude_faults) for photo in photos if photo.w_R_b is None]
    )
    if source is None or without == len(photos):
        said = warning(
            f"no attitude {'can be used' if faults else 'recorded'}: straight down assumed",
            "use a gimbal, as a tilted camera bends the map",
        )
    else:
        source = source.at_tilts(leaning)
        roll, pitch, yaw = source.std_deg
        good = f"{max(roll, pitch):.2g} degrees and the heading to {yaw:.2g}"
        said = note(
            f"attitude from {source.description}, assumed to be good to {good}",
            f"{counted(without, 'photograph')} without it" if without else "",
        )
    remarks = (*found.remarks, *lines, *band_remarks, *faults, said)
    return PhotoSet(tuple(photos), source, remarks, found.beside)


def _read(
    found: Sequence[tuple[str, Path]], left_out: dict[str, list[str]], progress: Progress
) -> list[Photo]:
    photos = []
    for k, (name, path) in enumerate(found):
        progress("tags", k, len(found))
        try:
            if not name.isprintable():
                name = name.encode("unicode_escape").decode()  # for the message
                raise InputError("a control character in the file's name; rename it")
            if not path.is_file():
                raise InputError("not a regular file")
            photos.append(Photo(name, path, read_tags(path)))
        except InputError as error:
            left_out[str(error)].append(name)
    progress("tags", len(found), len(found))
    return photos


def _of_one_band(
    photos: Sequence[Photo], wanted: str | None, left_out: dict[str, list[str]]
) -> tuple[list[Photo], tuple[Message, ...]]:
    """Return the photographs of one band, and a remark if there are several."""
    if not photos:
        return [], ()
    bands = [band_of(photo.name, photo.tags) for photo in photos]
    chosen = chosen_band(bands, wanted)
    for photo, band in zip(photos, bands, strict=True):
        if band != chosen:
            left_out[f"another band, {band}"].append(photo.name)
    others = sorted(set(bands) - {chosen})
    used = chosen if chosen.startswith("band ") else f"band {chosen}"
    remark = warning(f"{used} is used", f"slam import --band reads another: {', '.join(others)}")
    return [p for p, b in zip(photos, bands, strict=True) if b == chosen], (remark,) * bool(others)


_GIMBAL = AttitudeSource("the gimbal's angles", lambda tags: tags.gimbal, body_from_gimbal, GIMBAL_STD_DEG)
_CAMERA = AttitudeSource("the camera's angles", lambda tags: tags.mount, body_from_mount, GIMBAL_STD_DEG)
_SOURCES = (
    _GIMBAL,
    _CAMERA,
    AttitudeSource(
        "the airframe's angles with a fixed camera", lambda tags: tags.airframe, body_from_mount, (5, 5, 10)
    ),
)
"""Sources in the order of their accuracy. A kind that is zero in every photograph was not recorded."""


def _attitude_source(tags: Sequence[PhotoTags]) -> AttitudeSource | None:
    """Return the most accurate source that was recorded."""
    source = next((s for s in _SOURCES if any(any(s.angles(t) or ()) for t in tags)), None)
    if source is not _CAMERA:
        return source
    # Some makers store the gimbal's angles under Pix4D's names. All photographs of a set have one convention,
    # the one by which more of them look down.
    as_gimbal = replace(_CAMERA, w_R_b=body_from_gimbal)
    down = {s: sum(_looks_down(s, t) for t in tags) for s in (as_gimbal, _CAMERA)}
    return as_gimbal if down[as_gimbal] > down[_CAMERA] else _CAMERA


def _looks_down(source: AttitudeSource, tags: PhotoTags) -> bool:
    angles = source.angles(tags)
    return angles is not None and tilt_deg(source.w_R_b(*angles)) <= MAX_TILT_DEG


def _with_attitude(photo: Photo, source: AttitudeSource | None) -> Photo:
    angles = source.angles(photo.tags) if source is not None else None
    return photo if source is None or angles is None else replace(photo, w_R_b=source.w_R_b(*angles))


def _of_ground(photos: Sequence[Photo], left_out: dict[str, list[str]]) -> list[Photo]:
    """Return the photographs that show useful ground or have no attitude."""
    kept = []
    for photo in photos:
        tags, reason = photo.tags, ""
        if photo.w_R_b is not None:
            reason = why_no_ground(photo.w_R_b, tags.size_px, relative_focal(tags))
        if reason:
            left_out[reason].append(photo.name)
        else:
            kept.append(photo)
    return kept


def _of_one_camera(photos: Sequence[Photo], left_out: dict[str, list[str]]) -> list[Photo]:
    """Return the largest group with one model, size, focal length and zoom.

    Of equal groups, it is the one with the widest view, as its pictures overlap most; then the one with the
    most pixels, and then the first by name.
    """
    if not photos:
        return []
    kinds = _kinds([photo.tags for photo in photos])
    groups: dict[_Kind, list[Photo]] = defaultdict(list)
    for photo, kind in zip(photos, kinds, strict=True):
        groups[kind].append(photo)
    used = min(groups, key=lambda kind: _rank(groups[kind]))
    for photo, kind in zip(photos, kinds, strict=True):
        if reason := kind.difference(used):
            left_out[reason].append(photo.name)
    return groups[used]


def _originals(photos: Sequence[Photo], left_out: dict[str, list[str]]) -> list[Photo]:
    """Return the photographs of one camera without copies."""
    copies = are_copies([photo.tags for photo in photos], [photo.path.stat().st_size for photo in photos])
    for photo, is_copy in zip(photos, copies, strict=True):
        if is_copy:
            left_out[REASON].append(photo.name)
    return [photo for photo, is_copy in zip(photos, copies, strict=True) if not is_copy]


@dataclass(frozen=True)
class _Kind:
    """Properties that photographs of one camera and lens have in common."""

    make: str
    model: str
    size_px: tuple[int, int]
    focal_mm: float | None
    lens_name: str
    zoom: tuple[float, ...] = ()
    """Typical values of the quantities that a zoom changes (`slam.io.photos.zoom`)."""

    @classmethod
    def of(cls, tags: PhotoTags) -> _Kind:
        return cls(tags.make, tags.model, tags.size_px, tags.focal_mm, tags.lens_name)

    def difference(self, used: _Kind) -> str:
        """Return why a photograph of this kind is left out beside the ones in use; empty for the same."""
        if self == used:
            return ""
        if self.size_px != used.size_px:
            other = "another size than the {} x {} px of the ones in use".format(*used.size_px)
        elif (self.make, self.model) != (used.make, used.model):
            other = f"another camera than the {used.model or 'nameless one'} of the ones in use"
        elif self.lens_name != used.lens_name and self.focal_mm == used.focal_mm:
            other = "another lens of the camera than that of the ones in use"
        elif self.focal_mm == used.focal_mm:
            factors = [own / other for own, other in zip(self.zoom, used.zoom, strict=True)]
            factor = max(factors, key=lambda factor: abs(math.log(factor)))
            other = f"another zoom, {factor:.3g} times the focal length of the ones in use"
        else:
            other = f"another focal length than the {used.focal_mm or '(unknown)'} mm of the ones in use"
        return f"{other}; map them alone"


def _kinds(photos: Sequence[PhotoTags]) -> list[_Kind]:
    """Return the kind of each photograph; those of one lens are compared for their zoom."""
    kinds = [_Kind.of(tags) for tags in photos]
    for lens in set(kinds):
        same = [k for k, kind in enumerate(kinds) if kind == lens]
        for k, zoom in zip(same, zooms([photos[k] for k in same]), strict=True):
            kinds[k] = replace(lens, zoom=zoom)
    return kinds


def _rank(group: Sequence[Photo]) -> tuple[int, float, int]:
    """Return a key that sorts the group to use first."""
    tags = group[0].tags
    # Rounding of the focal length on 35 mm film makes equal lenses of two cameras differ by some percent.
    return -len(group), round(relative_focal(tags), 1), -tags.size_px[0] * tags.size_px[1]
